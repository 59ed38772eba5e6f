"use strict";
// The page: which charts there are, one time window for all of them, drawn one after the other, the nearest first.

const view = { from: 0, to: SAMPLES };
const charts = [];
let clock, drawing = false;

function draw(chart) {
  chart.stale = false;
  const { data, layout } = chart.figure(chart.div.clientWidth), first = !chart.div.on;
  Plotly.react(chart.div, data, layout, { displayModeBar: false, doubleClick: false });
  if (!first) return;
  chart.div.on("plotly_relayout", (change) => {
    const axis = Object.keys(change).find((key) => /^xaxis\d*\.range\[0\]$/.test(key));
    if (axis) zoom(change[axis], change[axis.replace("[0]", "[1]")]);
  });
  chart.div.on("plotly_doubleclick", () => show(0, SAMPLES));
  if (chart.select) chart.div.on("plotly_click", ({ points }) => chart.select(points[0].y));
}

/** How far a chart is from the screen, in pixels. */
function distance({ div }) {
  const { top, bottom } = div.getBoundingClientRect();
  return Math.max(0, top - innerHeight, -bottom);
}

/** Draw all that is out of date, also what is off the screen; the page answers between two charts. */
function drawAll() {
  if (drawing) return;
  drawing = true;
  const next = () => {
    const stale = charts.filter((c) => c.stale);
    drawing = stale.length > 0;
    if (!drawing) return;
    try {
      draw(stale.reduce((a, b) => (distance(b) < distance(a) ? b : a)));
    } catch (error) {
      trouble(error);
    }
    setTimeout(next);
  };
  setTimeout(next);
}

function redraw() {
  for (const chart of charts) chart.stale = true;
  explainBins();
  drawAll();
}

/** Its height is reserved at once, so that the page does not jump when it is drawn. */
function addChart(div, height, figure, select) {
  div.style.minHeight = `${height}px`;
  const chart = { div, figure, select, stale: true };
  charts.push(chart);
  drawAll();
  return chart;
}

function dropChart(chart) {
  charts.splice(charts.indexOf(chart), 1);
  if (chart.div.on) Plotly.purge(chart.div);
  chart.div.remove();
}

const galleries = [];
const CHUNK = 12;

/** All panels of a section, in as many columns as there is room for; drawn in chunks, so that long lists stay fast. */
function gallery(section, panels, height) {
  const host = section.appendChild(document.createElement("div"));
  host.className = "gallery";
  const self = { perRow: 0, parts: [], host };
  self.arrange = () => {
    const perRow = sideBySide(host.clientWidth, panels.length);
    if (perRow === self.perRow) return;
    self.perRow = perRow;
    self.parts.splice(0).forEach(dropChart);
    for (let i = 0; i < panels.length; i += CHUNK) {
      const shown = panels.slice(i, i + CHUNK), div = host.appendChild(document.createElement("div"));
      div.className = "plot";
      const whole = Math.ceil(shown.length / perRow) * height + FOOT;
      self.parts.push(addChart(div, whole, (width) => grid(shown, perRow, height, width, view, clock)));
    }
  };
  /** Bring one panel to the screen. */
  self.reveal = (i) => {
    const { top } = self.parts[Math.floor(i / CHUNK)].div.getBoundingClientRect();
    const row = Math.floor((i % CHUNK) / self.perRow);
    scrollTo({ top: scrollY + top + row * height - innerHeight / 3, behavior: "smooth" });
  };
  self.arrange();
  galleries.push(self);
  return self;
}

/** Show samples [from, to) in every chart. */
function show(from, to) {
  const width = Math.min(SAMPLES, Math.max(Math.min(10, SAMPLES), Math.round(to - from)));
  view.from = Math.min(Math.max(0, Math.round(from)), SAMPLES - width);
  view.to = view.from + width;
  document.getElementById("window-text").textContent =
    `${clock.text(view.from)} to ${clock.text(view.to - 1)} · ${width.toLocaleString("en")} samples`;
  for (const button of document.querySelectorAll("#window button")) {
    const { move } = button.dataset;
    button.disabled = { left: view.from === 0, right: view.to === SAMPLES, in: width <= 10 }[move] ?? width === SAMPLES;
  }
  redraw();
}

/** Show what a reader dragged over, given as axis values (dates come as text). */
function zoom(low, high) {
  const number = (v) => (typeof v === "string" ? Date.parse(v.replace(" ", "T") + (v.length > 10 ? "Z" : "")) : v);
  show(clock.index(number(low)), clock.index(number(high)));
}

function move(how) {
  const width = view.to - view.from;
  const [from, to] = {
    left: [view.from - width / 2, view.to - width / 2], right: [view.from + width / 2, view.to + width / 2],
    in: [view.from + width / 4, view.to - width / 4], out: [view.from - width / 2, view.to + width / 2], whole: [0, SAMPLES],
  }[how];
  show(from, to);
}

/** What a heat-map column stands for, said where it stands for more than one sample. */
function explainBins() {
  const width = Math.ceil((view.to - view.from) / most(plotOf("trust").clientWidth));
  const bound = boundOfLargest(MANIFEST.bound, width), sigmas = (z) => `${Number(z.toFixed(1))}σ`;
  document.getElementById("trust-hint").textContent = width < 2 ? "" :
    `Each column is ${width} samples: the least trust among them; red if any was suspected, the more the deeper. Zoom in for single samples.`;
  document.getElementById("surprise-hint").textContent = (width < 2 ? "" :
    `Each column is the largest of ${width} samples, which passes ${sigmas(bound)} as rarely as a single one passes ${sigmas(MANIFEST.bound)}. `) +
    "Select a row to see its channel below.";
  document.getElementById("surprise-key").textContent = `0 to ${sigmas(bound)}, beyond, ${sigmas(2 * bound)} and more`;
}

/** The page in light colours and at paper width while it is printed; everything is drawn before it returns. */
function printAs(printing) {
  document.documentElement.classList.toggle("printing", printing);
  for (const details of document.querySelectorAll("details")) details.open ||= printing;
  fitPage();
  if (printing) charts.filter((chart) => chart.stale).forEach(draw);
}

/** Arrange and draw anew for another width. */
function fitPage() {
  galleries.forEach((g) => g.arrange());
  redraw();
}

function listen() {
  document.addEventListener("click", ({ target }) => {
    if (target.dataset.move) move(target.dataset.move);
    if (target.dataset.sample === undefined) return;
    const sample = Number(target.dataset.sample), width = Math.max(60, Math.min(SAMPLES / 10, 600));
    show(sample - width / 3, sample + (2 * width) / 3);
    sectionOf("trust").scrollIntoView({ behavior: "smooth" });
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let shownWidth = innerWidth;
  let settled = 0;
  addEventListener("resize", () => {
    clearTimeout(settled);
    settled = setTimeout(() => {
      if (innerWidth !== shownWidth) fitPage();
      shownWidth = innerWidth;
    }, 200);
  });
  addEventListener("beforeprint", () => printAs(true));
  addEventListener("afterprint", () => printAs(false));
}

async function start() {
  clock = await makeClock();
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await gunzip("plotly"));
  document.head.append(script);
  document.getElementById("window").hidden = false;
  listen();
  show(0, SAMPLES);
  const suspected = await buildTrust();
  await buildInjections(suspected);
  await buildStates();
  await buildInnovations(suspected);
  await buildSolver();
}

function trouble(error) {
  const note = document.getElementById("trouble");
  note.hidden = false;
  note.textContent = typeof DecompressionStream === "undefined"
    ? "This browser is too old to unpack the charts (it lacks DecompressionStream, in browsers since 2023). The tables are complete."
    : `The charts could not be drawn: ${error.message}`;
  console.error(error);
}

start().catch(trouble);
