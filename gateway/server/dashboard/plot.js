/** Draws a series on a canvas: 60 s from left to right, a line for each value, a cursor. */

import { WINDOW_S } from "./series.js";
import { clock, plain } from "./format.js";

const LEFT = 52;
const RIGHT = 10;
const TOP = 10;
const BOTTOM = 22;
const STEPS = [1, 2, 2.5, 5, 10];
const TICK_S = 15;
const WIDE_TICK_S = 30;
const NARROW = 420;
const TURN = 180;

/** Where the times of the window fall on the canvas, in CSS pixels. */
export function timeScale(width, end) {
  const begin = end - WINDOW_S * 1000;
  const inner = Math.max(1, width - LEFT - RIGHT);
  return {
    begin,
    x: (t) => LEFT + ((t - begin) / (WINDOW_S * 1000)) * inner,
    t: (x) => begin + ((x - LEFT) / inner) * WINDOW_S * 1000,
  };
}

/** Draw; `picture`: {series, shown: [bool], turns, end, cursor, colours, unit}. */
export function plot(canvas, picture) {
  const ratio = Math.min(3, window.devicePixelRatio || 1);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (!width || !height) return;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = `11px ${picture.colours.font}`;
  const scale = timeScale(width, picture.end);
  const first = Math.max(0, picture.series.from(scale.begin) - 1);
  const [low, high] = span(picture, first);
  const y = (value) => TOP + ((high - value) / (high - low)) * (height - TOP - BOTTOM);
  grid(pen, picture, scale, y, low, high, width, height);
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 1);
  pen.clip();
  pen.lineWidth = 1.5;
  pen.lineJoin = "round";
  picture.shown.forEach((shown, n) => {
    if (shown) line(pen, picture, n, first, scale, y);
  });
  if (picture.cursor !== null) {
    pen.strokeStyle = picture.colours.text;
    pen.lineWidth = 1;
    const x = Math.round(scale.x(picture.cursor)) + 0.5;
    pen.beginPath();
    pen.moveTo(x, TOP);
    pen.lineTo(x, height - BOTTOM);
    pen.stroke();
  }
  pen.restore();
}

function span(picture, first) {
  let low = Infinity;
  let high = -Infinity;
  for (let n = first; n < picture.series.rows.length; n++) {
    const row = picture.series.rows[n];
    if (!row) continue;
    for (let k = 0; k < row.length; k++) {
      const value = row[k];
      if (value === null || !picture.shown[k]) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) return [-1, 1];
  const margin = Math.max((high - low) * 0.06, Math.abs(high) * 1e-3, 1e-6);
  return [low - margin, high + margin];
}

function grid(pen, picture, scale, y, low, high, width, height) {
  const { colours } = picture;
  const rough = (high - low) / Math.max(2, (height - TOP - BOTTOM) / 36);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * STEPS.find((one) => one * power >= rough);
  pen.strokeStyle = colours.grid;
  pen.fillStyle = colours.faint;
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (let n = Math.ceil(low / step); n * step <= high; n++) {
    const at = Math.round(y(n * step)) + 0.5;
    pen.beginPath();
    pen.moveTo(LEFT, at);
    pen.lineTo(width - RIGHT, at);
    pen.stroke();
    pen.fillText(plain(Number((n * step).toPrecision(10))), LEFT - 6, at);
  }
  pen.textBaseline = "alphabetic";
  for (let back = WINDOW_S; back >= 0; back -= width < NARROW ? WIDE_TICK_S : TICK_S) {
    const t = picture.end - back * 1000;
    const at = Math.round(scale.x(t)) + 0.5;
    pen.beginPath();
    pen.moveTo(at, height - BOTTOM);
    pen.lineTo(at, height - BOTTOM + 4);
    pen.stroke();
    pen.textAlign = back === WINDOW_S ? "left" : back === 0 ? "right" : "center";
    pen.fillText(back === 0 ? clock(t * 1000) : `−${back} s`, back === 0 ? at + 4 : at, height - 6);
  }
}

function line(pen, picture, n, first, scale, y) {
  const { times, rows } = picture.series;
  pen.strokeStyle = picture.colours.lines[n % picture.colours.lines.length];
  pen.beginPath();
  let before = null;
  for (let k = first; k < rows.length && times[k] <= picture.end; k++) {
    const value = rows[k]?.[n] ?? null;
    if (value !== null) {
      const jumps = picture.turns && before !== null && Math.abs(value - before) > TURN;
      if (before === null || jumps) pen.moveTo(scale.x(times[k]), y(value));
      pen.lineTo(scale.x(times[k]), y(value));
    }
    before = value;
  }
  pen.stroke();
}
