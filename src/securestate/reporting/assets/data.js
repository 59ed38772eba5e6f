"use strict";
// The data: unpacking what Python packed, time, and thinning to what a screen can show.

const MANIFEST = JSON.parse(document.getElementById("manifest").textContent);
const SAMPLES = MANIFEST.samples;
const MISSING = -32768;

/** The bytes behind a script element's base64 of gzip; the element is dropped to free its memory. */
async function gunzip(id) {
  const element = document.getElementById(id);
  const raw = atob(element.textContent);
  element.remove();
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** A packed table: codes column by column, and the value of a code. */
async function unpack(name) {
  const { rows, columns, delta, offset, step } = MANIFEST.blocks[name];
  const planes = new Uint8Array(await gunzip("data-" + name));
  const codes = new Int16Array(rows * columns);
  for (let i = 0; i < codes.length; i++) codes[i] = planes[i] | (planes[codes.length + i] << 8);
  if (delta) {
    for (let i = 0; i < codes.length; i++) if (i % rows) codes[i] += codes[i - 1];
  }
  return {
    columns,
    column: (c) => codes.subarray(c * rows, (c + 1) * rows),
    code: (c, value) => (value - offset[c]) / step[c],
    value: (c, code) => (code === MISSING ? null : offset[c] + step[c] * code),
  };
}

/** Time axis: sample index to axis value and back. Dates are milliseconds since 1970. */
async function makeClock() {
  const { unit, decimals, regular } = MANIFEST.time;
  const table = regular ? null : new Float64Array(await gunzip("data-time"));
  const at = (i) => (table ? table[i] : regular[0] + regular[1] * i);
  const last = SAMPLES - 1;
  /** Axis value of the edge before sample i, half way to its neighbour. */
  const edge = (i) => {
    if (last === 0) return at(0) + (i - 0.5);
    if (i <= 0) return at(0) - (at(1) - at(0)) / 2;
    return i > last ? at(last) + (at(last) - at(last - 1)) / 2 : (at(i - 1) + at(i)) / 2;
  };
  /** First sample not before an axis value. */
  const index = (value) => {
    let low = 0, high = SAMPLES;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (at(middle) < value) low = middle + 1;
      else high = middle;
    }
    return low;
  };
  const text = (i) => {
    if (unit === "date") return new Date(at(i)).toISOString().replace("T", " ").replace(/(:00)?\.\d+Z$/, "");
    return unit === "sample" ? `sample ${i}` : `${at(i).toFixed(decimals)} ${unit}`;
  };
  return { unit, at, edge, index, text, step: regular && regular[1] };
}

/** Samples [from, to) in at most `most` bins: their first samples, with `to` at the end. */
function bins(from, to, most) {
  const width = Math.max(1, Math.ceil((to - from) / most));
  const starts = [];
  for (let i = from; i < to; i += width) starts.push(i);
  starts.push(to);
  return starts;
}

/** Samples that draw a line over [from, to): all, or the least and the greatest of every bin, so no spike is lost. */
function thin(column, from, to, most) {
  const starts = bins(from, to, to - from <= most ? to - from : most / 2);
  const samples = [];
  for (let b = 0; b + 1 < starts.length; b++) {
    let least = -1, greatest = -1;
    for (let i = starts[b]; i < starts[b + 1]; i++) {
      if (column[i] === MISSING) continue;
      if (least < 0 || column[i] < column[least]) least = i;
      if (greatest < 0 || column[i] > column[greatest]) greatest = i;
    }
    if (least < 0) samples.push(starts[b]);
    else if (least === greatest) samples.push(least);
    else samples.push(Math.min(least, greatest), Math.max(least, greatest));
  }
  return samples;
}

/** In what share of the samples of every bin `holds` is true. */
function shares(starts, holds) {
  const result = new Array(starts.length - 1).fill(0);
  for (let b = 0; b < result.length; b++) {
    for (let i = starts[b]; i < starts[b + 1]; i++) if (holds(i)) result[b]++;
    result[b] /= starts[b + 1] - starts[b];
  }
  return result;
}

/** The extreme of every bin of a column by `better(new, old)`; null where all is missing. */
function extremes(column, starts, better) {
  const result = new Array(starts.length - 1).fill(null);
  for (let b = 0; b < result.length; b++) {
    for (let i = starts[b]; i < starts[b + 1]; i++) {
      const code = column[i];
      if (code !== MISSING && (result[b] === null || better(code, result[b]))) result[b] = code;
    }
  }
  return result;
}
