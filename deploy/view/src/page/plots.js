// The plots of the paper's figures: distance from the centre, distances between vehicles, altitude.

import { byId, setText } from "./dom.js";
import * as format from "./format.js";
import { SINGLE } from "./frame.js";
import { goals } from "./map.js";
import { separation } from "./map-vehicles.js";
import { drawPlot, keyAt } from "./plot.js";
import { colours, vehicleColour } from "./theme.js";

/** With more vehicles the lines of all pairs would hide each other: then each vehicle's nearest is drawn. */
const PAIRS = 5;
const MOST_POINTS = 400;

export class Plots {
  /** `seek(key)` reports a click on a plot. */
  constructor({ seek }) {
    this.canvases = { centre: byId("plot-centre"), pairs: byId("plot-pairs"), altitude: byId("plot-altitude") };
    for (const canvas of Object.values(this.canvases)) {
      canvas.addEventListener("click", (event) => {
        const key = keyAt(canvas, event);
        if (key !== null) seek(key);
      });
    }
  }

  /** The pictures that a plot needs, not more than the screen can show. */
  read(scene) {
    const { history, player, swarm } = scene;
    const range = swarm.isLive ? [history.frames[0]?.key ?? 0, history.newest?.key ?? 1] : player.range;
    const all = history.frames;
    const every = Math.max(1, Math.ceil(all.length / MOST_POINTS));
    // Always the same pictures, so that the lines do not tremble as time passes.
    const frames = every === 1 ? all : all.filter((frame, at) => at === all.length - 1 || Math.floor(frame.key * 10) % every === 0);
    const formation = goals(scene.frame, swarm)[0]?.formation ?? swarm.formation(0, 0);
    const flown = flownFormations(frames, swarm);
    const cursor = player.isLookingBack || !swarm.isLive ? player.position : null;
    return { ...scene, range, frames, formation, flown, cursor, offset_s: history.offset_s };
  }

  /** Draws one of the plots: `centre`, `pairs` or `altitude`. */
  draw(name, scene) {
    const read = this.read(scene);
    const isSingle = scene.swarm.vehicles.length <= SINGLE;
    const content = { centre: centrePlot, pairs: pairsPlot, altitude: altitudePlot }[name](read, isSingle);
    const { range, cursor, offset_s } = read;
    drawPlot(this.canvases[name], { range, cursor, offset_s, ...content });
  }
}

/** The formation at each picture, `[key, formation]`, if an operator has changed one in flight; else `null`. */
function flownFormations(frames, swarm) {
  if (!frames.some(({ isTuned }) => isTuned)) return null;
  const flown = frames.map((frame) => [frame.key, goals(frame, swarm)[0]?.formation]);
  return flown.filter(([, formation]) => formation);
}

/** A limit of the formation; with `points` if it was not the same all the time. */
function limit({ flown, formation }, of, about) {
  const value = formation && of(formation);
  if (!Number.isFinite(value)) return [];
  const points = flown?.flatMap(([key, one]) => [key, of(one)]);
  return [{ value, text: about(format.number(value, Number.isInteger(value) ? 0 : 1)), ...(points ? { points } : {}) }];
}

/** A line for each vehicle; in a large swarm the spread of all and lines of the selected. */
function linesOf(read, isSingle, value) {
  const { swarm, selected, frame } = read;
  const shown = isSingle ? [...swarm.vehicles.keys()] : [...selected].slice(0, 8);
  const isAnyChosen = selected.size > 0;
  return shown.map((index) => {
    const points = pointsOf(read, (one) => value(one, index));
    const isChosen = selected.has(index);
    const colour = isSingle ? lineColour(swarm, index) : colours.text;
    return { label: swarm.ids[index], colour, points, isBold: isChosen, isFaint: isAnyChosen && !isChosen };
  }).filter(() => frame);
}

/** The points of a line, `[key, value, ...]`; it is broken where nothing was received. */
function pointsOf({ frames, history }, value) {
  const points = [];
  frames.forEach((one, at) => {
    if (at > 0 && history.isBroken(frames[at - 1].key, one.key)) points.push(one.key, NaN);
    points.push(one.key, value(one));
  });
  return points;
}

function lineColour(swarm, index) {
  return swarm.vehicles.length <= 8 ? vehicleColour(swarm, index) : colours.vehicles[index % colours.vehicles.length];
}

/** The rows of a spread, in pieces between which nothing was received. */
function spreadOf({ frames, history }, isSingle, name) {
  if (isSingle) return null;
  const pieces = [[]];
  let before = null;
  for (const { key, spread } of frames) {
    if (!spread?.[name]) continue;
    if (before !== null && history.isBroken(before, key)) pieces.push([]);
    pieces.at(-1).push([key, ...spread[name]]);
    before = key;
  }
  return pieces;
}

const byRow = (values) => (frame, index) => {
  const row = frame.rowOf(index);
  return row < 0 ? NaN : frame[values][row];
};

function centrePlot(read, isSingle) {
  const { formation, swarm } = read;
  const of = swarm.isLarge ? "middle of the team" : "centre";
  setText(byId("plot-centre-title"), `Distance from the ${of}, m`);
  const limits = [];
  let band = null;
  const radius = formation?.radius_m;
  if (radius) {
    const isBand = formation.law !== "flock" && formation.inner_width_m > 0;
    const inner = (one) => Math.max(0, one.radius_m - one.inner_width_m);
    const outer = (one) => one.radius_m + one.outer_width_m;
    if (isBand) {
      band = read.flown?.map(([key, one]) => [key, inner(one), outer(one)]) ?? [inner(formation), outer(formation)];
      limits.push(...limit(read, outer, (metres) => `band to ${metres} m`));
      limits.push(...limit(read, inner, (metres) => `band from ${metres} m`).map((one) => ({ ...one, isBelow: true })));
    } else {
      limits.push(...limit(read, ({ radius_m }) => radius_m, (metres) => `radius ${metres} m`));
    }
  }
  return { lines: linesOf(read, isSingle, byRow("distance")), spreads: spreadOf(read, isSingle, "distance"), limits, band };
}

function pairsPlot(read, isSingle) {
  const { swarm, selected } = read;
  const title = byId("plot-pairs-title");
  if (swarm.isLarge) {
    setText(title, "Vehicles in contact (line) and in place (bold), %");
    const line = (name, colour, isBold) => ({
      colour, isBold, points: pointsOf(read, ({ spread }) => spread?.[name] ?? NaN),
    });
    return { lines: [line("contact", colours.muted, false), line("place", colours.ok, true)], most: 105 };
  }
  const limits = [{ value: swarm.collision_m, text: `collision ${swarm.collision_m} m`, level: "bad" }];
  const safety = limit(read, ({ safety_distance_m }) => safety_distance_m ?? swarm.safety_m, (metres) => `safety ${metres} m`);
  limits.unshift(...safety.map((one) => ({ ...one, level: "warn" })));
  const ids = [...swarm.vehicles.keys()];
  const only = selected.size === 1 && isSingle ? [...selected][0] : null;
  if (only === null && ids.length > PAIRS) {
    setText(title, "Distance of the nearest vehicle, m");
    return { lines: linesOf(read, isSingle, byRow("nearest")), spreads: spreadOf(read, isSingle, "nearest"), limits };
  }
  setText(title, only === null ? "Distances between vehicles, m" : `Distances from vehicle ${swarm.ids[only]}, m`);
  const pairs = only === null
    ? ids.flatMap((one) => ids.slice(one + 1).map((two) => [one, two]))
    : ids.filter((index) => index !== only).map((index) => [only, index]);
  const lines = pairs.map(([one, two], at) => ({
    label: only === null ? `${swarm.ids[one]}–${swarm.ids[two]}` : swarm.ids[two],
    colour: only === null ? colours.vehicles[(at + 1) % colours.vehicles.length] : lineColour(swarm, two),
    points: pointsOf(read, (frame) => separation(frame, one, two)),
  }));
  return { lines, limits };
}

function altitudePlot(read, isSingle) {
  const limits = limit(read, ({ altitude_m }) => altitude_m, (metres) => `setpoint ${metres} m`);
  for (const name of ["ceiling", "floor"]) {
    const value = read.swarm.scenario.airspace?.[`${name}_m`];
    if (value) limits.push({ value, text: `${name} ${value} m`, level: "warn" });
  }
  const lines = linesOf(read, isSingle, (frame, index) => frame.altitude[index]);
  return { lines, spreads: spreadOf(read, isSingle, "altitude"), limits };
}
