"use strict";
// The page: which charts there are, one time window for all of them, drawing only what is on the screen.

const view = { from: 0, to: SAMPLES };
const charts = [];
let clock;

const observer = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    const chart = charts.find((c) => c.div === entry.target);
    chart.visible = entry.isIntersecting;
    draw(chart);
  }
}, { rootMargin: "300px" });

function draw(chart) {
  if (!chart.visible || !chart.stale) return;
  chart.stale = false;
  const { data, layout } = chart.figure();
  const first = !chart.div.on;
  Plotly.react(chart.div, data, { ...layout, width: chart.div.clientWidth }, { displayModeBar: false, doubleClick: false });
  if (!first) return;
  chart.div.on("plotly_relayout", (change) => {
    if (change["xaxis.range[0]"] !== undefined) zoom(change["xaxis.range[0]"], change["xaxis.range[1]"]);
  });
  chart.div.on("plotly_doubleclick", () => show(0, SAMPLES));
}

function redraw() {
  for (const chart of charts) chart.stale = true;
  explainBins();
  requestAnimationFrame(() => charts.forEach(draw));
}

/** Its height is reserved at once, so that the page does not jump when it is drawn. */
function addChart(section, height, figure) {
  const div = section.querySelector(".plot");
  div.style.minHeight = `${height}px`;
  const chart = { div, figure, stale: true, visible: false };
  charts.push(chart);
  observer.observe(div);
  return chart;
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

/** Columns of a heat map: no more than the screen can show. */
const most = (div) => Math.min(1500, Math.max(200, Math.round(div.clientWidth - leftMargin())));

/** A section that shows a few rows of a long list at a time, and a way to choose which. */
function pages(section, names, perPage, row, height) {
  const pager = section.querySelector(".pager");
  let first = 0;
  const chart = addChart(section, Math.min(perPage, names.length) * height + 60, () => {
    const shown = names.slice(first, first + perPage).map((_, i) => row(first + i));
    return stack(shown, view, clock, height);
  });
  if (names.length <= perPage) return { open: () => {} };
  const select = document.createElement("select");
  select.setAttribute("aria-label", "first shown");
  names.forEach((name, i) => select.add(new Option(name, i)));
  const open = (i) => {
    first = Math.min(Math.max(0, i), names.length - 1);
    select.value = first;
    count.textContent = `${first + 1}–${Math.min(first + perPage, names.length)} of ${names.length}`;
    back.disabled = first === 0;
    forth.disabled = first + perPage >= names.length;
    chart.stale = true;
    draw(chart);
  };
  const button = (text, step, label) => {
    const b = document.createElement("button");
    b.textContent = text;
    b.setAttribute("aria-label", label);
    b.onclick = () => open(first + step);
    return b;
  };
  const back = button("‹", -perPage, "previous"), forth = button("›", perPage, "next");
  const count = document.createElement("span");
  select.onchange = () => open(Number(select.value));
  pager.append(select, back, forth, count);
  open(0);
  return { open };
}

/** Channels in the order a reader wants: those of liars first, then by how often their sensor was suspected. */
const ranked = MANIFEST.channels.map((_, i) => i).sort((a, b) => {
  const [s, t] = [a, b].map((c) => MANIFEST.sensors[MANIFEST.channels[c].sensor]);
  return t.lies - s.lies || t.share - s.share || a - b;
});

function channelRow(table, suspected, c, unit, shapes) {
  const channel = MANIFEST.channels[c], column = table.column(c);
  const title = withUnit(cut(channel.name, PHONE.matches ? 28 : 80), plain(unit));
  return {
    title: MANIFEST.sensors[channel.sensor].lies ? tone(title, css("red")) : title,
    shapes,
    traces: (axis) => lineTraces(view, clock, axis, column, (code) => table.value(c, code), suspicion(suspected, channel.sensor)),
  };
}

function stateRow(x, deviation, s) {
  const column = x.column(s), spread = deviation.column(s);
  const edge = (sign) => (i) => {
    const centre = x.value(s, column[i]), width = deviation.value(s, spread[i]);
    return centre === null || width === null ? NaN : centre + 2 * sign * width;
  };
  return {
    title: plain(MANIFEST.states[s]),
    traces: (axis) => [
      ...bandTraces(view, clock, axis, edge(-1), edge(1)),
      ...lineTraces(view, clock, axis, column, (code) => x.value(s, code)),
    ],
  };
}

function diagnosticRow(table, d) {
  const column = table.column(d);
  return {
    title: plain(MANIFEST.diagnostics[d]),
    traces: (axis) => lineTraces(view, clock, axis, column, (code) => table.value(d, code)),
  };
}

const sectionOf = (name) => document.querySelector(`section[data-chart="${name}"]`);

async function buildTrust() {
  const data = { trust: await unpack("trust"), suspected: await unpack("suspected") };
  const section = sectionOf("trust");
  addChart(section, heatHeight(MANIFEST.sensors.length), () => trustChart(data, view, clock, most(section.querySelector(".plot"))));
  return data.suspected;
}

async function buildInjections(suspected) {
  const attack = await unpack("attack"), section = sectionOf("attack");
  const known = ranked.filter((c) => attack.column(c).some((code) => code !== MISSING));
  if (!known.length) {
    section.querySelector(".hint").textContent = "This estimator made no estimate of injections.";
    return;
  }
  const suspects = known.filter((c) => MANIFEST.sensors[MANIFEST.channels[c].sensor].share > 0).length;
  pages(section, known.map((c) => MANIFEST.channels[c].name), Math.max(2, Math.min(4, suspects)),
    (i) => channelRow(attack, suspected, known[i], MANIFEST.channels[known[i]].unit), 130);
}

async function buildStates() {
  const x = await unpack("x"), deviation = await unpack("x_std");
  pages(sectionOf("states"), MANIFEST.states, 6, (s) => stateRow(x, deviation, s), 110);
}

async function buildInnovations(suspected) {
  const ratio = await unpack("ratio"), section = sectionOf("surprise"), bound = MANIFEST.bound;
  const chart = addChart(section, heatHeight(MANIFEST.channels.length), () =>
    surpriseChart({ ratio }, view, clock, most(section.querySelector(".plot"))));
  const shapes = (axis) => [dashed(bound, axis), dashed(-bound, axis)];
  const lines = pages(sectionOf("innovations"), ranked.map((c) => MANIFEST.channels[c].name), 3,
    (i) => channelRow(ratio, suspected, ranked[i], "σ", shapes), 140);
  whenDrawn(chart, () => chart.div.on("plotly_click", ({ points }) => lines.open(ranked.indexOf(points[0].y))));
}

/** Run `then` once, after the chart's first drawing. */
function whenDrawn(chart, then) {
  const figure = chart.figure;
  chart.figure = () => {
    chart.figure = figure;
    setTimeout(then);
    return figure();
  };
}

async function buildSolver() {
  const status = await unpack("status"), section = sectionOf("status");
  addChart(section, heatHeight(1), () => statusChart({ status }, view, clock, most(section.querySelector(".plot"))));
  if (!MANIFEST.blocks.diagnostics) {
    sectionOf("diagnostics").hidden = true;
    return;
  }
  const table = await unpack("diagnostics");
  pages(sectionOf("diagnostics"), MANIFEST.diagnostics, 6, (d) => diagnosticRow(table, d), 100);
}

/** What a heat-map column stands for, said where it stands for more than one sample. */
function explainBins() {
  const width = Math.ceil((view.to - view.from) / most(document.querySelector(".plot")));
  const bound = boundOfLargest(MANIFEST.bound, width), sigmas = (z) => `${Number(z.toFixed(1))}σ`;
  document.getElementById("trust-hint").textContent = width < 2 ? "" :
    `Each column is ${width} samples: the least trust among them; red if any was suspected, the more the deeper. Zoom in for single samples.`;
  document.getElementById("surprise-hint").textContent = (width < 2 ? "" :
    `Each column is the largest of ${width} samples, which passes ${sigmas(bound)} as rarely as a single one passes ${sigmas(MANIFEST.bound)}. `) +
    "Select a row to see its channel below.";
  document.getElementById("surprise-key").textContent = `0 to ${sigmas(bound)}, beyond, ${sigmas(2 * bound)} and more`;
}

/** The page in light colours and at paper width while it is printed. */
function printAs(printing) {
  document.documentElement.classList.toggle("printing", printing);
  for (const chart of charts) {
    chart.stale = true;
    chart.visible ||= printing;
    draw(chart);
  }
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
  addEventListener("resize", redraw);
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

start().catch((error) => {
  const note = document.getElementById("trouble");
  note.hidden = false;
  note.textContent = typeof DecompressionStream === "undefined"
    ? "This browser is too old to unpack the charts (it lacks DecompressionStream, in browsers since 2023). The tables are complete."
    : `The charts could not be drawn: ${error.message}`;
  console.error(error);
});
