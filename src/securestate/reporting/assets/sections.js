"use strict";
// The sections of the page: which charts each one has.

/** Channels in the order a reader wants: those of liars first, then by how often their sensor was suspected. */
const sensorOf = (c) => MANIFEST.sensors[MANIFEST.channels[c].sensor];
const ranked = MANIFEST.channels.map((_, i) => i).sort((a, b) => {
  const [s, t] = [sensorOf(a), sensorOf(b)];
  return t.lies - s.lies || t.share - s.share || a - b;
});

function channelPanel(table, suspected, c, more) {
  const { sensor } = MANIFEST.channels[c], column = table.column(c), red = suspicion(suspected, sensor);
  return { red: sensorOf(c).lies, ...more, traces: (where) => lineTraces(where, column, (code) => table.value(c, code), red) };
}

function statePanel(x, deviation, s, other) {
  const column = x.column(s), spread = deviation.column(s);
  const edge = (sign) => (i) => {
    const centre = x.value(s, column[i]), width = deviation.value(s, spread[i]);
    return centre === null || width === null ? NaN : centre + 2 * sign * width;
  };
  return {
    title: MANIFEST.states[s],
    traces: (where) => [
      ...bandTraces(where, edge(-1), edge(1)),
      ...(other ? besideTraces(where, other.column(s), (code) => other.value(s, code)) : []),
      ...lineTraces(where, column, (code) => x.value(s, code)),
    ],
  };
}

function diagnosticPanel(table, d) {
  const column = table.column(d);
  return { title: MANIFEST.diagnostics[d], traces: (where) => lineTraces(where, column, (code) => table.value(d, code)) };
}

const sectionOf = (name) => document.querySelector(`section[data-chart="${name}"]`);
const plotOf = (name) => sectionOf(name).querySelector(".plot");

async function buildTrust() {
  const data = { trust: await unpack("trust"), suspected: await unpack("suspected") };
  addChart(plotOf("trust"), heatHeight(MANIFEST.sensors.length), (width) => trustChart(data, width, view, clock));
  return data.suspected;
}

/** Least and greatest value of a column over the whole run; null if there is none. */
function extent(table, c) {
  const whole = [0, SAMPLES], [low] = extremes(table.column(c), whole, (a, b) => a < b);
  if (low === null) return null;
  return [low, extremes(table.column(c), whole, (a, b) => a > b)[0]].map((code) => table.value(c, code));
}

/** One scale for all channels of a unit; never so fine that noise fills it. */
function unitRange(channels, extents) {
  const noise = 4 * Math.max(...channels.map((c) => MANIFEST.channels[c].noise));
  const low = Math.min(-noise, ...channels.map((c) => extents[c][0])), high = Math.max(noise, ...channels.map((c) => extents[c][1]));
  return [low - (high - low) / 20, high + (high - low) / 20];
}

/** What several channels lie between, at every sample. */
function envelope(table, channels) {
  const low = new Float64Array(SAMPLES).fill(Infinity), high = new Float64Array(SAMPLES).fill(-Infinity);
  for (const c of channels) {
    table.column(c).forEach((code, i) => {
      const value = table.value(c, code);
      if (value === null) return;
      if (value < low[i]) low[i] = value;
      if (value > high[i]) high[i] = value;
    });
  }
  return (where) => bandTraces(where, (i) => low[i], (i) => high[i], 1);
}

/** All honest channels of a unit in one panel. */
function honestPanel(attack, channels, extents, unit, range) {
  const low = Math.min(...channels.map((c) => extents[c][0])), high = Math.max(...channels.map((c) => extents[c][1]));
  const who = channels.length === 1 ? MANIFEST.channels[channels[0]].label : `${channels.length} channels`;
  const span = low === high ? figures(low) : `${figures(low)} to ${figures(high)}`;
  return { title: `${who}: ${span} ${unit}`, range, traces: envelope(attack, channels) };
}

async function buildInjections(suspected) {
  const attack = await unpack("attack"), section = sectionOf("attack"), extents = MANIFEST.channels.map((_, c) => extent(attack, c));
  const known = ranked.filter((c) => extents[c]), accused = known.filter((c) => sensorOf(c).share > 0);
  if (!known.length) {
    section.querySelector(".hint").textContent = "This estimator made no estimate of injections.";
    return;
  }
  const unitOf = (c) => MANIFEST.channels[c].unit, units = [...new Set(known.map(unitOf))], ranges = {}, honest = [];
  for (const unit of units) {
    const all = known.filter((c) => unitOf(c) === unit), others = all.filter((c) => !accused.includes(c));
    ranges[unit] = unitRange(all, extents);
    if (others.length) honest.push(honestPanel(attack, others, extents, unit, ranges[unit]));
  }
  if (!accused.length) section.querySelector(".hint").textContent = "No sensor was suspected. The scales hold at least ±4σ of the noise.";
  else {
    gallery(section, accused.map((c) => channelPanel(attack, suspected, c, {
      title: withUnit(MANIFEST.channels[c].label, unitOf(c)), range: ranges[unitOf(c)],
    })), accused.length > 4 ? 110 : 130);
  }
  if (!honest.length) return;
  section.append(document.getElementById("honest").content.cloneNode(true));
  gallery(section, honest, 100);
}

async function buildStates() {
  const x = await unpack("x"), deviation = await unpack("x_std");
  const other = MANIFEST.blocks.beside ? await unpack("beside") : null;
  gallery(sectionOf("states"), MANIFEST.states.map((_, s) => statePanel(x, deviation, s, other)), 105);
}

const FARTHEST = 12;

async function buildInnovations(suspected) {
  const ratio = await unpack("ratio"), bound = MANIFEST.bound, extents = MANIFEST.channels.map((_, c) => extent(ratio, c) ?? [0, 0]);
  const far = extents.map((e) => (e[1] > -e[0] ? e[1] : e[0]));
  const edge = Math.min(FARTHEST, Math.max(2 * bound, ...far.map(Math.abs)));
  let lines = null;
  addChart(plotOf("surprise"), heatHeight(MANIFEST.channels.length), (width) => surpriseChart({ ratio }, width, view, clock),
    (row) => lines.reveal(ranked.indexOf(row)));
  const shapes = (where) => [dashed(bound, where), dashed(-bound, where)];
  lines = gallery(sectionOf("innovations"), ranked.map((c) => channelPanel(ratio, suspected, c, {
    title: MANIFEST.channels[c].label + (Math.abs(far[c]) > edge ? `, up to ${figures(far[c])} σ` : ""), range: [-edge, edge], shapes,
  })), 95);
}

async function buildSolver() {
  if (plotOf("status")) {
    const status = await unpack("status");
    addChart(plotOf("status"), heatHeight(1), (width) => statusChart({ status }, width, view, clock));
  }
  if (!MANIFEST.blocks.diagnostics) {
    sectionOf("diagnostics").hidden = true;
    return;
  }
  const table = await unpack("diagnostics");
  gallery(sectionOf("diagnostics"), MANIFEST.diagnostics.map((_, d) => diagnosticPanel(table, d)), 110);
}
