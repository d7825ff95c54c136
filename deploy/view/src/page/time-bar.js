// The time bar: where the picture is in the flight, the mission's steps and the marks of events.

import { byId, contextOf, setText, show } from "./dom.js";
import * as format from "./format.js";
import { colours, font } from "./theme.js";

export class TimeBar {
  /** `seek(key)` reports a click or a drag, `toggle`, `now`, `faster(places)` the buttons. */
  constructor({ seek, toggle, now, faster }) {
    this.canvas = byId("time-bar");
    const move = (event) => {
      if (event.buttons === 1 && this.range) seek(this.key(event));
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      move(event);
    });
    this.canvas.addEventListener("pointermove", move);
    byId("play").addEventListener("click", toggle);
    byId("now").addEventListener("click", now);
    byId("slower").addEventListener("click", () => faster(-1));
    byId("faster").addEventListener("click", () => faster(1));
  }

  key(event) {
    const part = (event.clientX - this.canvas.getBoundingClientRect().left) / this.canvas.clientWidth;
    return this.range[0] + Math.min(Math.max(part, 0), 1) * (this.range[1] - this.range[0]);
  }

  draw({ swarm, history, player, events, frame }) {
    this.range = player.range;
    const offset_s = history.offset_s;
    const flight = frame.t_s ?? (offset_s === null ? null : frame.key - offset_s);
    const behind = player.isLookingBack ? history.newest.key - player.position : 0;
    setText(byId("time"), flight === null || flight < 0 ? "not started" : format.time(flight, true));
    byId("time").dataset.past = String(player.isLookingBack);
    setText(byId("play"), player.isPlaying ? "❚❚" : "▶");
    setText(byId("speed-text"), `${player.speed}×`);
    const now = byId("now");
    setText(now, !swarm.isLive ? "end" : behind ? `now (${format.time(behind)} ago)` : "live");
    now.dataset.live = String(swarm.isLive && !player.isLookingBack);
    show(byId("speed"), !swarm.isLive || player.isLookingBack);
    this.drawBar({ swarm, history, player, events, frame, offset_s: offset_s ?? 0 });
  }

  drawBar({ swarm, history, player, events, offset_s }) {
    const ready = contextOf(this.canvas);
    if (!ready) return;
    const { context, width, height } = ready;
    const [from, to] = this.range;
    const x = (key) => ((key - from) / (to - from)) * width;
    const rail = { top: 0.48 * height, height: 0.2 * height };
    drawSteps(context, stepsOf(events, history, swarm, this.range), x, width, rail.top - 2, swarm);
    context.fillStyle = colours.line;
    context.fillRect(0, rail.top, width, rail.height);
    // What the page keeps and can show at once.
    const kept = history.frames;
    const first = swarm.isLive ? (kept[0]?.key ?? to) : from;
    const bar = (colour, begin, end) => {
      context.fillStyle = colour;
      if (end > begin) context.fillRect(x(begin), rail.top, x(end) - x(begin), rail.height);
    };
    if (swarm.isLive && kept.length) bar(colours.faint, first, kept.at(-1).key);
    bar(colours.accent, first, player.position);
    for (const [begin, end] of history.gaps) bar(colours.line, begin, end);
    for (const event of events.all) {
      const key = events.key(event, history);
      if (key < from || key > to) continue;
      const colour = { bad: colours.bad, warn: colours.warn }[event.level];
      context.fillStyle = colour ?? colours.text;
      context.globalAlpha = colour ? 1 : 0.35;
      context.fillRect(x(key) - 0.5, rail.top - (colour ? 5 : 0), colour ? 2 : 1, rail.height + (colour ? 5 : 0));
    }
    context.globalAlpha = 1;
    const at = Math.min(Math.max(x(player.position), 5), width - 5);
    context.fillStyle = colours.text;
    context.beginPath();
    context.arc(at, rail.top + rail.height / 2, Math.max(5, 0.16 * height), 0, 2 * Math.PI);
    context.fill();
    drawTimes(context, x, width, height, this.range, offset_s);
    this.canvas.setAttribute("aria-valuetext", format.time(player.position - offset_s));
  }
}

/** When the first vehicle entered each mission step: `[key, step]`, from the events. */
function stepsOf(events, history, swarm, [from]) {
  if (swarm.teams.length > 1) return [];
  const found = new Map([[0, Math.min(from, history.offset_s ?? from)]]);
  for (const event of events.all) {
    const step = Number(/^(?:continues|skips forward.*) to step (\d+)/.exec(event.text)?.[1]);
    if (Number.isInteger(step) && !found.has(step)) found.set(step, events.key(event, history));
  }
  return [...found].map(([step, key]) => [key, step]).sort((a, b) => a[0] - b[0]);
}

function drawSteps(context, steps, x, width, bottom, swarm) {
  if (swarm.steps.length < 2) return;
  context.font = font(0.72, 600);
  context.textBaseline = "middle";
  context.textAlign = "left";
  const top = 2;
  steps.forEach(([key, step], at) => {
    const left = Math.max(0, x(key));
    const right = at + 1 < steps.length ? x(steps[at + 1][0]) : width;
    if (right < 0 || right - left < 2) return;
    context.fillStyle = step % 2 ? colours.line : colours.band;
    context.fillRect(left, top, right - left - 1, bottom - top);
    const text = swarm.stepName(step);
    if (context.measureText(text).width + 10 > right - left) return;
    context.fillStyle = colours.muted;
    context.fillText(text, left + 5, (top + bottom) / 2 + 0.5);
  });
}

function drawTimes(context, x, width, height, [from, to], offset_s) {
  context.font = font(0.7);
  context.fillStyle = colours.muted;
  context.textBaseline = "bottom";
  const marks = Math.max(2, Math.floor(width / (7 * colours.rem)));
  const step_s = [5, 10, 30, 60, 120, 300, 600, 1800, 3600].find((step) => (to - from) / step <= marks) ?? 7200;
  for (let t = Math.ceil((from - offset_s) / step_s) * step_s; t + offset_s <= to; t += step_s) {
    const at = x(t + offset_s);
    context.textAlign = at < 20 ? "left" : at > width - 20 ? "right" : "center";
    context.fillText(format.time(t), at, height);
  }
}
