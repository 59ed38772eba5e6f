"use strict";
// The charts: one function per chart, from the visible window to a plotly figure.

const LINE_POINTS = 2000;
const PHONE = matchMedia("(max-width: 700px)");

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
/** plotly reads a little HTML in its texts; names come from files. */
const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
const cut = (text, most) => plain(text.length > most ? text.slice(0, most - 1) + "…" : text);
const short = (text) => cut(text, PHONE.matches ? 11 : 24);
const tone = (text, colour) => `<span style="color:${colour}">${text}</span>`;
const withUnit = (name, unit) => (unit ? `${name} (${unit})` : name);

/** Room for the names on the left; the same in every chart, so that their time axes stand in line. */
function leftMargin() {
  const names = [...MANIFEST.sensors, ...MANIFEST.channels].map((n) => n.name.length);
  return 22 + 6.6 * Math.min(Math.max(6, ...names), PHONE.matches ? 11 : 24);
}

const DATE_TICKS = [
  { dtickrange: [null, 60000], value: "%H:%M:%S\n%Y-%m-%d" },
  { dtickrange: [60000, 86400000], value: "%H:%M\n%Y-%m-%d" },
  { dtickrange: [86400000, null], value: "%Y-%m-%d" },
];

function timeAxis(view, clock) {
  const titles = { date: "", sample: "sample", s: "time (s)", min: "time (min)", h: "time (h)", d: "time (d)" };
  return {
    type: clock.unit === "date" ? "date" : "linear",
    range: [clock.edge(view.from), clock.edge(view.to)],
    title: { text: titles[clock.unit], standoff: 6, font: { size: 11 } },
    hoverformat: clock.unit === "date" ? "%Y-%m-%d %H:%M:%S" : ".7~g",
    tickformatstops: clock.unit === "date" ? DATE_TICKS : [],
    nticks: PHONE.matches ? 4 : 10,
    gridcolor: css("line"), zeroline: false, linecolor: css("line"), ticks: "outside", tickcolor: css("line"),
  };
}

function layout(height, more) {
  return {
    height,
    margin: { l: leftMargin(), r: 14, t: 8, b: 46 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, -apple-system, Segoe UI, Roboto, sans-serif", size: 11, color: css("ink") },
    hoverlabel: { bgcolor: css("card"), bordercolor: css("line"), font: { color: css("ink") }, align: "left" },
    showlegend: false,
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    ...more,
  };
}

/** Where the bins lie; evenly spaced ones as start and step, which plotly draws much faster. */
function columns(clock, starts) {
  if (!clock.step) return { x: starts.map(clock.edge) };
  const width = starts[1] - starts[0];
  return { x0: clock.at(starts[0] + (width - 1) / 2), dx: width * clock.step };
}

/** A heat map with one named row per entry of z, over the bins that start at `starts`. */
function heatmap(view, clock, starts, names, z, hover, scale, [low, high]) {
  const count = names.length;
  const every = Math.max(1, Math.ceil(12 / rowHeight(count)));
  const rows = names.map((_, i) => i).filter((i) => i % every === 0);
  return {
    data: [{
      type: "heatmap", ...columns(clock, starts), y0: 0, dy: 1, z, customdata: hover,
      zmin: low, zmax: high, colorscale: scale, showscale: false, hoverongaps: false,
      hovertemplate: "%{customdata}<extra></extra>",
    }],
    layout: layout(heatHeight(count), {
      xaxis: { ...timeAxis(view, clock), showgrid: false },
      yaxis: {
        range: [count - 0.5, -0.5], fixedrange: true, tickvals: rows, ticktext: rows.map((i) => names[i]),
        showgrid: false, zeroline: false, ticks: "outside", ticklen: 5, tickcolor: "rgba(0,0,0,0)",
      },
      plot_bgcolor: css("missing"), hovermode: "closest",
    }),
  };
}

const rowHeight = (count) => Math.max(7, Math.min(26, Math.round(840 / count)));
const heatHeight = (count) => count * rowHeight(count) + 60;

const suspectedText = (share) => (share === 1 ? " · suspected" : share ? ` · suspected ${Math.ceil(100 * share)} % of it` : "");

/** Whether a sensor was suspected, by sample. */
function suspicion(suspected, sensor) {
  const flags = suspected.column(sensor), half = suspected.code(sensor, 0.5);
  return (i) => flags[i] > half;
}

/** The time of every bin, as text. */
const periods = (clock, starts) => starts.slice(0, -1).map((start, b) => {
  const last = starts[b + 1] - 1;
  return last === start ? clock.text(start) : `${clock.text(start)} – ${clock.text(last)}`;
});

/** Least trust per bin; a bin with a suspected sample is red, the more of them the deeper. */
function trustChart({ trust, suspected }, view, clock, most) {
  const starts = bins(view.from, view.to, most), period = periods(clock, starts);
  const z = [], hover = [];
  MANIFEST.sensors.forEach((sensor, s) => {
    const least = extremes(trust.column(s), starts, (a, b) => a < b).map((code) => code === null ? null : trust.value(s, code));
    const share = shares(starts, suspicion(suspected, s));
    z.push(least.map((value, b) => (share[b] ? -Math.sqrt(share[b]) : value)));
    hover.push(least.map((value, b) =>
      `<b>${plain(sensor.name)}</b><br>${period[b]}<br>trust ${value === null ? "–" : value.toFixed(2)}${suspectedText(share[b])}`));
  });
  const names = MANIFEST.sensors.map((s) => (s.lies ? tone(short(s.name), css("red")) : short(s.name)));
  const scale = [[0, css("red")], [0.4999, css("red-faint")], [0.5, css("trust-none")], [1, css("trust-full")]];
  return heatmap(view, clock, starts, names, z, hover, scale, [-1, 1]);
}

/** The bound that the largest of `width` normal values passes as rarely as a single one passes `bound`. */
function boundOfLargest(bound, width) {
  const rare = (z) => Math.exp(-z * z / 2) / (z + 1 / (z + 2 / (z + 3 / (z + 4 / z))));
  let low = bound, high = bound + 10;
  for (let i = 0; i < 50; i++) {
    const middle = (low + high) / 2;
    if (width * rare(middle) > rare(bound)) low = middle;
    else high = middle;
  }
  return low;
}

/** Greatest |innovation| per bin, in standard deviations; beyond the bound for such a bin it turns from blue to amber. */
function surpriseChart({ ratio }, view, clock, most) {
  const starts = bins(view.from, view.to, most), period = periods(clock, starts);
  const z = [], hover = [];
  MANIFEST.channels.forEach((channel, c) => {
    const column = ratio.column(c);
    const up = extremes(column, starts, (a, b) => a > b), down = extremes(column, starts, (a, b) => a < b);
    const worst = up.map((code, b) => {
      if (code === null) return null;
      const top = ratio.value(c, code), bottom = ratio.value(c, down[b]);
      return top > -bottom ? top : bottom;
    });
    z.push(worst.map((value) => (value === null ? null : Math.abs(value))));
    hover.push(worst.map((value, b) =>
      `<b>${plain(channel.name)}</b><br>${period[b]}<br>${value === null ? "missing" : value.toFixed(2) + " σ"}`));
  });
  const names = MANIFEST.channels.map((c) => MANIFEST.sensors[c.sensor].lies ? tone(short(c.name), css("red")) : short(c.name));
  const scale = [[0, css("calm")], [0.4999, css("bound")], [0.5, css("over")], [1, css("far")]];
  return heatmap(view, clock, starts, names, z, hover, scale, [0, 2 * boundOfLargest(MANIFEST.bound, starts[1] - starts[0])]);
}

/** The status of every sample as one strip; the worst of every bin. */
function statusChart({ status }, view, clock, most) {
  const starts = bins(view.from, view.to, most), period = periods(clock, starts);
  const worst = extremes(status.column(0), starts, (a, b) => a > b).map((code) => Math.round(status.value(0, code)));
  const names = ["OK", "NO_MEASUREMENT", "NOT_CONVERGED", "ILL_CONDITIONED"];
  const colours = [css("calm"), css("missing"), css("over"), css("purple")];
  const scale = colours.flatMap((colour, i) => [[i / 4, colour], [(i + 0.9999) / 4, colour]]).concat([[1, colours[3]]]);
  const hover = worst.map((code, b) => `${period[b]}<br>${names[code]}`);
  return heatmap(view, clock, starts, ["status"], [worst], [hover], scale, [-0.5, 3.5]);
}

/** One line over the window, thinned; red at the samples where `isRed` says so, and next to them where points are dense. */
function lineTraces(view, clock, axis, column, value, isRed) {
  const samples = thin(column, view.from, view.to, LINE_POINTS);
  const x = samples.map(clock.at), y = samples.map((i) => value(column[i]));
  const mode = samples.length < 80 ? "lines+markers" : "lines";
  const line = { x, y, mode, yaxis: axis, line: { color: css("accent"), width: 1.2 }, marker: { size: 4 }, hovertemplate: "%{y:.4~g}<extra></extra>" };
  if (!isRed) return [line];
  const red = samples.map(isRed), dense = samples.length > 400;
  const marked = y.map((v, i) => (red[i] || (dense && (red[i - 1] || red[i + 1])) ? v : null));
  const mark = { x, y: marked, mode: dense ? "lines" : "lines+markers", yaxis: axis, line: { color: css("red"), width: 1.4 }, marker: { size: 4 }, hoverinfo: "skip" };
  return [line, mark];
}

/** A filled band between a lower and an upper column, thinned to its outermost edge per bin. */
function bandTraces(view, clock, axis, lower, upper) {
  const starts = bins(view.from, view.to, LINE_POINTS / 2);
  const x = [], low = [], high = [];
  for (let b = 0; b + 1 < starts.length; b++) {
    let least = Infinity, greatest = -Infinity;
    for (let i = starts[b]; i < starts[b + 1]; i++) {
      least = Math.min(least, lower(i));
      greatest = Math.max(greatest, upper(i));
    }
    if (!(least <= greatest)) continue;
    x.push((clock.at(starts[b]) + clock.at(starts[b + 1] - 1)) / 2);
    low.push(least);
    high.push(greatest);
  }
  const edge = { x, yaxis: axis, mode: "lines", line: { width: 0 }, hoverinfo: "skip" };
  return [{ ...edge, y: low }, { ...edge, y: high, fill: "tonexty", fillcolor: css("band") }];
}

/** Rows above each other that share one time axis. Each row: {title, traces(axis), shapes?(axis)}. */
function stack(rows, view, clock, height) {
  const gap = 24 / (rows.length * height), data = [], axes = {}, shapes = [];
  const annotations = rows.map((row, r) => {
    const top = 1 - r / rows.length, name = r ? `y${r + 1}` : "y";
    data.push(...row.traces(name));
    shapes.push(...(row.shapes ? row.shapes(name) : []));
    axes[r ? `yaxis${r + 1}` : "yaxis"] = {
      domain: [top - 1 / rows.length, top - gap], fixedrange: true, gridcolor: css("line"), zerolinecolor: css("line"),
      nticks: 5, tickformat: ".4~g", anchor: "x",
    };
    return { text: row.title, xref: "paper", yref: "paper", x: 0, y: top - gap, xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12 } };
  });
  const bottom = rows.length > 1 ? `y${rows.length}` : "y";
  return {
    data,
    layout: layout(rows.length * height + 60, {
      ...axes, annotations, shapes, xaxis: { ...timeAxis(view, clock), anchor: bottom }, hovermode: "x",
    }),
  };
}

const dashed = (y, axis) => ({
  type: "line", xref: "paper", x0: 0, x1: 1, yref: axis, y0: y, y1: y, line: { color: css("soft"), width: 1, dash: "dash" },
});
