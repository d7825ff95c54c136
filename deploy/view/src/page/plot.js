// A plot over time: lines of single vehicles or the spread of many, with labelled limits.

import { contextOf, pointIn } from "./dom.js";
import * as format from "./format.js";
import { colours, font } from "./theme.js";

/**
 * Draws a plot into a canvas.
 * `lines`: `{ label, colour, isBold, isFaint, points: [x, y, ...] }`; `spreads`: pieces of rows `[x, least, lower, median, upper, most]`;
 * `limits`: `{ value, text, level, isBelow, points }`, with `points` the same over time if it has changed; `band`: rows
 * `[x, from, to]` of the values, shaded, or `[from, to]` if they have not changed; `cursor`: x of the present picture.
 */
export function drawPlot(canvas, { range, lines = [], spreads = null, limits = [], band = null, cursor, offset_s, most }) {
  const ready = contextOf(canvas);
  if (!ready) return;
  const { context, width, height } = ready;
  const rem = colours.rem;
  const box = { left: 2.7 * rem, right: width - 1.6 * rem, top: 0.5 * rem, bottom: height - 1.25 * rem };
  const top = scaleOf(lines, spreads, limits, most);
  const x = (key) => box.left + ((key - range[0]) / Math.max(1e-6, range[1] - range[0])) * (box.right - box.left);
  const y = (value) => box.bottom - (value / top) * (box.bottom - box.top);
  const plot = { context, box, x, y, range, offset_s };
  if (band) drawBand(plot, Array.isArray(band[0]) ? band : [[range[0], ...band], [range[1], ...band]], top);
  drawAxes(plot, top);
  context.save();
  context.beginPath();
  context.rect(box.left, box.top - 2, box.right - box.left + 1, box.bottom - box.top + 4);
  context.clip();
  (spreads ?? []).forEach((rows) => drawSpread(plot, rows));
  lines.forEach((line) => drawLine(plot, line));
  context.restore();
  drawLimits(plot, limits, top);
  drawEnds(plot, lines);
  if (cursor !== null && cursor >= range[0] && cursor <= range[1]) {
    context.strokeStyle = colours.text;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(Math.round(x(cursor)) + 0.5, box.top);
    context.lineTo(Math.round(x(cursor)) + 0.5, box.bottom);
    context.stroke();
  }
  canvas.plot = { left: box.left, right: box.right, range };
}

function scaleOf(lines, spreads, limits, most) {
  let top = most ?? 0;
  for (const { points } of lines) {
    for (let at = 1; at < points.length; at += 2) if (points[at] > top) top = points[at];
  }
  for (const row of spreads?.flat() ?? []) if (row[5] > top) top = row[5];
  for (const { value, points } of limits) {
    if (value > top) top = value;
    for (let at = 1; at < (points?.length ?? 0); at += 2) if (points[at] > top) top = points[at];
  }
  return most ?? Math.max(1, top * 1.08);
}

function drawBand({ context, x, y }, rows, top) {
  context.fillStyle = colours.band;
  context.beginPath();
  rows.forEach(([key, , to], at) => (at ? context.lineTo(x(key), y(Math.min(to, top))) : context.moveTo(x(key), y(Math.min(to, top)))));
  for (const [key, from] of [...rows].reverse()) context.lineTo(x(key), y(from));
  context.closePath();
  context.fill();
}

function drawAxes({ context, box, x, y, range, offset_s }, top) {
  const rem = colours.rem;
  context.font = font(0.7);
  context.fillStyle = colours.muted;
  context.strokeStyle = colours.line;
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const step = format.tickStep(top, Math.max(2, (box.bottom - box.top) / (2 * rem)));
  context.beginPath();
  for (let value = 0; value <= top * 1.001; value += step) {
    const at = Math.round(y(value)) + 0.5;
    context.moveTo(box.left, at);
    context.lineTo(box.right, at);
    context.fillText(format.number(value, step < 1 ? 1 : 0), box.left - 4, at);
  }
  context.stroke();
  context.textAlign = "center";
  context.textBaseline = "top";
  // Marks at whole minutes or seconds of the flight.
  const span = range[1] - range[0];
  const steps = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];
  const marks = Math.max(2, (box.right - box.left) / (5 * rem));
  const step_s = steps.find((seconds) => span / seconds <= marks) ?? 7200;
  const zero = offset_s ?? 0;
  for (let t = Math.ceil((range[0] - zero) / step_s) * step_s; t + zero <= range[1]; t += step_s) {
    context.fillText(format.time(t), x(t + zero), box.bottom + 3);
  }
}

function drawLine({ context, x, y }, { points, colour, isBold, isFaint }) {
  context.strokeStyle = colour;
  context.lineWidth = isBold ? 2.2 : 1.3;
  context.globalAlpha = isFaint ? 0.25 : 1;
  context.lineJoin = "round";
  context.beginPath();
  let isDown = false;
  for (let at = 0; at < points.length; at += 2) {
    if (!Number.isFinite(points[at + 1])) {
      isDown = false;
      continue;
    }
    if (isDown) context.lineTo(x(points[at]), y(points[at + 1]));
    else context.moveTo(x(points[at]), y(points[at + 1]));
    isDown = true;
  }
  context.stroke();
  context.globalAlpha = 1;
}

function drawSpread({ context, x, y }, rows) {
  const area = (low, high, alpha) => {
    context.beginPath();
    rows.forEach((row, at) => (at ? context.lineTo(x(row[0]), y(row[high])) : context.moveTo(x(row[0]), y(row[high]))));
    for (const row of [...rows].reverse()) context.lineTo(x(row[0]), y(row[low]));
    context.closePath();
    context.globalAlpha = alpha;
    context.fillStyle = colours.accent;
    context.fill();
    context.globalAlpha = 1;
  };
  if (rows.length === 0) return;
  area(1, 5, 0.2);
  area(2, 4, 0.35);
  drawLine({ context, x, y }, { points: rows.flatMap((row) => [row[0], row[3]]), colour: colours.accent, isBold: true });
}

function drawLimits({ context, box, x, y }, limits, top) {
  context.font = font(0.7, 600);
  context.textAlign = "left";
  context.textBaseline = "bottom";
  // The texts of near lines stand side by side.
  let [left, above] = [box.left + 4, -Infinity];
  for (const { value, text, level, isBelow, points } of limits) {
    if (value > top) continue;
    const at = Math.round(y(value)) + 0.5;
    const colour = { bad: colours.bad, warn: colours.warn }[level] ?? colours.ring;
    context.strokeStyle = colour;
    context.lineWidth = 1;
    context.setLineDash([5, 4]);
    context.beginPath();
    if (points) {
      for (let nth = 0; nth < points.length; nth += 2) context.lineTo(x(points[nth]), y(Math.min(points[nth + 1], top)));
    } else {
      context.moveTo(box.left, at);
      context.lineTo(box.right, at);
    }
    context.stroke();
    context.setLineDash([]);
    const hasRoom = isBelow && at + 1.1 * colours.rem < box.bottom;
    if (hasRoom || at - above > 1.1 * colours.rem) left = box.left + 4;
    const baseline = hasRoom ? at + colours.rem : at - 1;
    context.lineWidth = 3;
    context.strokeStyle = colours.ground;
    context.strokeText(text, left, baseline);
    context.fillStyle = colour;
    context.fillText(text, left, baseline);
    above = at;
    left += context.measureText(text).width + 12;
  }
}

/** The ids at the ends of the lines, moved apart. */
function drawEnds({ context, box, x, y }, lines) {
  const ends = lines
    .filter(({ label, points, isFaint }) => label && !isFaint && Number.isFinite(points.at(-1)))
    .map(({ label, colour, points }) => ({ label, colour, x: x(points.at(-2)), y: y(points.at(-1)) }))
    .sort((a, b) => a.y - b.y);
  const height = 0.78 * colours.rem;
  if (ends.length * height > box.bottom - box.top + height) return;
  ends.forEach((end, at) => {
    if (at > 0) end.y = Math.max(end.y, ends[at - 1].y + height);
  });
  const over = (ends.at(-1)?.y ?? 0) - box.bottom;
  if (over > 0) ends.forEach((end) => (end.y -= over));
  context.font = font(0.7, 600);
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const { label, colour, x: at, y: height_px } of ends) {
    context.fillStyle = colour;
    context.fillText(label, Math.min(at, box.right) + 4, height_px);
  }
}

/** The key under a pixel of a plot drawn before. */
export function keyAt(canvas, event) {
  if (!canvas.plot) return null;
  const { left, right, range } = canvas.plot;
  const part = (pointIn(canvas, event)[0] - left) / (right - left);
  return range[0] + Math.min(Math.max(part, 0), 1) * (range[1] - range[0]);
}
