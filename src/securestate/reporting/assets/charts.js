"use strict";
// What every chart shares: colours, names cut to measure, time axis, layout; and line panels in a grid.

const PHONE = matchMedia("(max-width: 700px)");
const FONT = "system-ui, -apple-system, Segoe UI, Roboto, sans-serif";
const NAME_SIZE = 11, TITLE_SIZE = 12;

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
/** plotly reads a little HTML in its texts; names come from files. */
const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
const tone = (text, colour) => `<span style="color:${colour}">${text}</span>`;
const withUnit = (name, unit) => (unit ? `${name} (${unit})` : name);
const figures = (value) => String(Number(value.toPrecision(2))).replace("-", "−");

const ruler = document.createElement("canvas").getContext("2d");
function textWidth(text, size) {
  ruler.font = `${size}px ${FONT}`;
  return ruler.measureText(text).width;
}

/** A text that fits into `room` pixels; what has no room is cut out of its middle. */
function fit(text, room, size) {
  if (textWidth(text, size) <= room) return plain(text);
  let kept = text.length - 1;
  const cut = () => `${text.slice(0, Math.ceil(kept / 2)).trimEnd()}…${text.slice(text.length - Math.floor(kept / 2)).trimStart()}`;
  while (kept > 2 && textWidth(cut(), size) > room) kept--;
  return plain(cut());
}

/** Room for the names left of heat maps; the same for all, so that their time axes stand in line. */
function nameRoom(width) {
  const names = [...MANIFEST.sensors.map((s) => s.name), ...MANIFEST.channels.map((c) => c.label), "status"];
  return Math.ceil(Math.min(0.36 * width, Math.max(30, ...names.map((n) => textWidth(n, NAME_SIZE)))));
}
const leftMargin = (width) => (PHONE.matches ? 8 : nameRoom(width) + 16);

const DATE_TICKS = [
  { dtickrange: [null, 60000], value: "%H:%M:%S\n%Y-%m-%d" },
  { dtickrange: [60000, 86400000], value: "%H:%M\n%Y-%m-%d" },
  { dtickrange: [86400000, null], value: "%Y-%m-%d" },
];

function timeAxis(view, clock, ticks) {
  const titles = { date: "", sample: "sample", s: "time (s)", min: "time (min)", h: "time (h)", d: "time (d)" };
  return {
    type: clock.unit === "date" ? "date" : "linear",
    range: [clock.edge(view.from), clock.edge(view.to)],
    title: { text: titles[clock.unit], standoff: 6, font: { size: 11 } },
    hoverformat: clock.unit === "date" ? "%Y-%m-%d %H:%M:%S" : ".7~g",
    tickformatstops: clock.unit === "date" ? DATE_TICKS : [],
    nticks: ticks,
    gridcolor: css("line"), zeroline: false, linecolor: css("line"), ticks: "outside", tickcolor: css("line"),
  };
}

function layout(width, height, more) {
  return {
    width, height,
    margin: { l: leftMargin(width), r: 14, t: 8, b: 46 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: FONT, size: NAME_SIZE, color: css("ink") },
    hoverlabel: { bgcolor: css("card"), bordercolor: css("line"), font: { color: css("ink") }, align: "left" },
    showlegend: false,
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    ...more,
  };
}

/** One line over the window, thinned to `points`; red at the samples where `isRed` says so, and next to them where points are dense. */
function lineTraces({ view, clock, points, x: xaxis, y: yaxis }, column, value, isRed) {
  const samples = thin(column, view.from, view.to, points);
  const x = samples.map(clock.at), y = samples.map((i) => value(column[i]));
  const mode = samples.length < 80 ? "lines+markers" : "lines";
  const line = { x, y, mode, xaxis, yaxis, line: { color: css("accent"), width: 1.2 }, marker: { size: 4 }, hovertemplate: "%{y:.4~g}<extra></extra>" };
  if (!isRed) return [line];
  const red = samples.map(isRed), dense = samples.length > 400;
  if (!red.includes(true)) return [line];
  const marked = y.map((v, i) => (red[i] || (dense && (red[i - 1] || red[i + 1])) ? v : null));
  const mark = { x, y: marked, mode: dense ? "lines" : "lines+markers", xaxis, yaxis, line: { color: css("red"), width: 1.4 }, marker: { size: 4 }, hoverinfo: "skip" };
  return [line, mark];
}

/** The same line of another estimator, behind it. */
function besideTraces(where, column, value) {
  return lineTraces(where, column, value).map((trace) => ({ ...trace, mode: "lines", line: { color: css("purple"), width: 1.2 } }));
}

/** A filled band between a lower and an upper edge, thinned to its outermost per bin. */
function bandTraces({ view, clock, points, x: xaxis, y: yaxis }, lower, upper, width = 0) {
  const starts = bins(view.from, view.to, points / 2);
  const x = [], low = [], high = [];
  for (let b = 0; b + 1 < starts.length; b++) {
    let least = Infinity, greatest = -Infinity;
    for (let i = starts[b]; i < starts[b + 1]; i++) {
      least = Math.min(least, lower(i));
      greatest = Math.max(greatest, upper(i));
    }
    const known = least <= greatest;
    x.push((clock.at(starts[b]) + clock.at(starts[b + 1] - 1)) / 2);
    low.push(known ? least : null);
    high.push(known ? greatest : null);
  }
  const edge = { x, xaxis, yaxis, mode: "lines", line: { width, color: css("accent") }, hoverinfo: "skip" };
  return [{ ...edge, y: low }, { ...edge, y: high, fill: "tonexty", fillcolor: css("band") }];
}

const PANEL = 290;
/** How many panels stand side by side: one below the other if they are few or the page is narrow. */
const sideBySide = (width, count) => (count <= 4 ? 1 : Math.max(1, Math.min(3, Math.floor(width / PANEL))));

const TITLE = 22, FOOT = 46, AXIS = 48;

/** Panels in a grid, all with the same time axis. A panel: {title, red?, range?, traces(where), shapes?(where)}. */
function grid(panels, perRow, height, width, view, clock) {
  const rows = Math.ceil(panels.length / perRow), tall = rows * height;
  const left = perRow === 1 && !PHONE.matches ? Math.max(AXIS, leftMargin(width)) : AXIS;
  const cell = (width - left - 14 + AXIS) / perRow, plot = cell - AXIS, whole = width - left - 14;
  const figure = { data: [], shapes: [], annotations: [], axes: {} };
  panels.forEach((panel, p) => {
    const row = Math.floor(p / perRow), n = p ? String(p + 1) : "", from = (p % perRow) * cell;
    const where = { view, clock, points: Math.max(200, 2 * Math.round(plot)), x: `x${n}`, y: `y${n}` };
    const lowest = p + perRow >= panels.length, top = 1 - (row * height + TITLE) / tall;
    const axis = timeAxis(view, clock, Math.max(3, Math.floor(plot / 80)));
    figure.axes[`xaxis${n}`] = {
      ...axis, domain: [from / whole, Math.min(1, (from + plot) / whole)], anchor: where.y, showticklabels: lowest, ticks: lowest ? "outside" : "",
      title: lowest ? axis.title : undefined, matches: n ? "x" : undefined,
    };
    figure.axes[`yaxis${n}`] = {
      domain: [Math.max(0, 1 - ((row + 1) * height - 4) / tall), top], anchor: where.x, fixedrange: true, gridcolor: css("line"), zerolinecolor: css("line"),
      nticks: Math.max(3, Math.round(height / 26)), tickformat: ".4~g", range: panel.range, autorange: !panel.range,
    };
    const title = fit(panel.title, plot, TITLE_SIZE);
    figure.annotations.push({
      text: panel.red ? tone(title, css("red")) : title, xref: "paper", yref: "paper", x: from / whole, y: top,
      xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: TITLE_SIZE }, borderpad: 1,
    });
    figure.data.push(...panel.traces(where));
    figure.shapes.push(...(panel.shapes ? panel.shapes(where) : []));
  });
  const { data, shapes, annotations, axes } = figure;
  const margin = { l: left, r: 14, t: 0, b: FOOT };
  return { data, layout: layout(width, tall + FOOT, { ...axes, annotations, shapes, margin, hovermode: "x" }) };
}

const dashed = (y, { x, y: axis }) => ({
  type: "line", xref: `${x} domain`, x0: 0, x1: 1, yref: axis, y0: y, y1: y, line: { color: css("soft"), width: 1, dash: "dash" },
});
