"use strict";
// The heat maps: from the visible window to a plotly figure.

/** Where the bins lie; evenly spaced ones as start and step, which plotly draws much faster. */
function columns(clock, starts) {
  if (!clock.step) return { x: starts.map(clock.edge) };
  const width = starts[1] - starts[0];
  return { x0: clock.at(starts[0] + (width - 1) / 2), dx: width * clock.step };
}

/** Columns of a heat map: no more than the screen can show. */
const most = (width) => Math.min(1500, Math.max(200, Math.round(width - leftMargin(width))));

/** A heat map with one named row per entry of z, over the bins that start at `starts`; null is missing. */
function heatmap(width, view, clock, starts, names, z, hover, scale, [low, high]) {
  const count = names.length, row = rowHeight(count), above = PHONE.matches;
  const below = low - (high - low) / 8, share = (high - low) / (high - below);
  const colours = [[0, css("missing")], [(1 - share) / 2, css("missing")], ...scale.map(([at, c]) => [1 - share * (1 - at), c])];
  colours.splice(2, 0, [(1 - share) / 2, colours[2][1]]);
  const text = names.map(({ name, red }) => {
    const fitted = fit(name, above ? width - 24 : nameRoom(width), NAME_SIZE);
    return red ? tone(fitted, css("red")) : fitted;
  });
  const labels = text.map((label, i) => ({
    text: label, xref: "paper", x: 0, xanchor: "left", y: i - 0.5, yref: "y", yanchor: "middle", showarrow: false, font: { size: NAME_SIZE }, borderpad: 0,
  }));
  return {
    data: [{
      type: "heatmap", ...columns(clock, starts), y0: 0, dy: 1, z: z.map((r) => r.map((v) => v ?? below)), customdata: hover,
      zmin: below, zmax: high, colorscale: colours, showscale: false, ygap: above ? row / 2 : 1,
      hovertemplate: "%{customdata}<extra></extra>",
    }],
    layout: layout(width, heatHeight(count), {
      xaxis: { ...timeAxis(view, clock, above ? 4 : 10), showgrid: false },
      yaxis: {
        range: [count - (above ? 0.7 : 0.5), above ? -0.8 : -0.5], fixedrange: true, tickvals: above ? [] : names.map((_, i) => i), ticktext: text,
        showgrid: false, zeroline: false, ticks: above ? "" : "outside", ticklen: 5, tickcolor: "rgba(0,0,0,0)",
      },
      annotations: above ? labels : [], hovermode: "closest",
    }),
  };
}

/** Every row has room for its name: beside it, or on a phone above it. */
const rowHeight = (count) => (PHONE.matches ? 30 : Math.max(14, Math.min(26, Math.round(840 / count))));
const heatHeight = (count) => count * rowHeight(count) + (PHONE.matches ? 66 : 60);

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
function trustChart({ trust, suspected }, width, view, clock) {
  const starts = bins(view.from, view.to, most(width)), period = periods(clock, starts);
  const z = [], hover = [];
  MANIFEST.sensors.forEach((sensor, s) => {
    const none = sensor.uncheckable ? "–, cannot be checked" : "–";
    const least = extremes(trust.column(s), starts, (a, b) => a < b).map((code) => code === null ? null : trust.value(s, code));
    const share = shares(starts, suspicion(suspected, s));
    z.push(least.map((value, b) => (share[b] ? -Math.sqrt(share[b]) : value)));
    hover.push(least.map((value, b) =>
      `<b>${plain(sensor.name)}</b><br>${period[b]}<br>trust ${value === null ? none : value.toFixed(2)}${suspectedText(share[b])}`));
  });
  const names = MANIFEST.sensors.map((s) => ({ name: s.name, red: s.lies }));
  const scale = [[0, css("red")], [0.4999, css("red-faint")], [0.5, css("trust-none")], [1, css("trust-full")]];
  return heatmap(width, view, clock, starts, names, z, hover, scale, [-1, 1]);
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
function surpriseChart({ ratio }, width, view, clock) {
  const starts = bins(view.from, view.to, most(width)), period = periods(clock, starts);
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
      `<b>${plain(channel.label)}</b><br>${period[b]}<br>${value === null ? "missing" : value.toFixed(2) + " σ"}`));
  });
  const names = MANIFEST.channels.map((c) => ({ name: c.label, red: MANIFEST.sensors[c.sensor].lies }));
  const scale = [[0, css("calm")], [0.4999, css("bound")], [0.5, css("over")], [1, css("far")]];
  return heatmap(width, view, clock, starts, names, z, hover, scale, [0, 2 * boundOfLargest(MANIFEST.bound, starts[1] - starts[0])]);
}

/** The status of every sample as one strip; the worst of every bin. */
function statusChart({ status }, width, view, clock) {
  const starts = bins(view.from, view.to, most(width)), period = periods(clock, starts);
  const worst = extremes(status.column(0), starts, (a, b) => a > b).map((code) => Math.round(status.value(0, code)));
  const names = ["OK", "NO_MEASUREMENT", "NOT_CONVERGED", "ILL_CONDITIONED", "BROKEN_DOWN", "AMBIGUOUS", "MAJORITY_SUSPECT",
    "COLD_START"];
  const colours = [css("calm"), css("missing"), css("over"), css("purple"), css("red"), css("bound"), css("far"),
    css("accent")], n = colours.length;
  const scale = colours.flatMap((colour, i) => [[i / n, colour], [(i + 0.9999) / n, colour]]).concat([[1, colours[n - 1]]]);
  const hover = worst.map((code, b) => `${period[b]}<br>${names[code]}`);
  return heatmap(width, view, clock, starts, [{ name: "status" }], [worst], [hover], scale, [-0.5, n - 0.5]);
}

