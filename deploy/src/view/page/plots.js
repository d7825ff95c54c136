// The plots of the paper's figures: distance from the centre, distances between vehicles, altitude.

import { byId, setText } from "./dom.js";
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
    const cursor = player.isLookingBack || !swarm.isLive ? player.position : null;
    return { ...scene, range, frames, formation, cursor, offset_s: history.offset_s };
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

/** A line for each vehicle; in a large swarm the spread of all and lines of the selected. */
function linesOf({ frames, swarm, selected, frame }, isSingle, value) {
  const shown = isSingle ? [...swarm.vehicles.keys()] : [...selected].slice(0, 8);
  const isAnyChosen = selected.size > 0;
  return shown.map((index) => {
    const points = [];
    for (const one of frames) points.push(one.key, value(one, index));
    const isChosen = selected.has(index);
    const colour = isSingle ? lineColour(swarm, index) : colours.text;
    return { label: swarm.ids[index], colour, points, isBold: isChosen, isFaint: isAnyChosen && !isChosen };
  }).filter(() => frame);
}

function lineColour(swarm, index) {
  return swarm.vehicles.length <= 8 ? vehicleColour(swarm, index) : colours.vehicles[index % colours.vehicles.length];
}

function spreadOf({ frames }, isSingle, name) {
  if (isSingle) return null;
  return frames.filter(({ spread }) => spread?.[name]).map(({ key, spread }) => [key, ...spread[name]]);
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
    if (isBand) {
      band = [Math.max(0, radius - formation.inner_width_m), radius + formation.outer_width_m];
      limits.push({ value: band[1], text: `band to ${band[1]} m` }, { value: band[0], text: `band from ${band[0]} m`, isBelow: true });
    } else {
      limits.push({ value: radius, text: `radius ${radius} m` });
    }
  }
  return { lines: linesOf(read, isSingle, byRow("distance")), spreads: spreadOf(read, isSingle, "distance"), limits, band };
}

function pairsPlot(read, isSingle) {
  const { swarm, selected, frames } = read;
  const title = byId("plot-pairs-title");
  if (swarm.isLarge) {
    setText(title, "Vehicles in contact (line) and in place (bold), %");
    const line = (name, colour, isBold) => ({
      colour, isBold, points: frames.flatMap(({ key, spread }) => [key, spread?.[name] ?? NaN]),
    });
    return { lines: [line("contact", colours.muted, false), line("place", colours.ok, true)], most: 105 };
  }
  const limits = [{ value: swarm.collision_m, text: `collision ${swarm.collision_m} m`, level: "bad" }];
  if (swarm.safety_m) limits.unshift({ value: swarm.safety_m, text: `safety ${swarm.safety_m} m`, level: "warn" });
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
    points: frames.flatMap((frame) => [frame.key, separation(frame, one, two)]),
  }));
  return { lines, limits };
}

function altitudePlot(read, isSingle) {
  const altitude = read.formation?.altitude_m;
  const limits = altitude ? [{ value: altitude, text: `setpoint ${altitude} m` }] : [];
  for (const name of ["ceiling", "floor"]) {
    const value = read.swarm.scenario.airspace?.[`${name}_m`];
    if (value) limits.push({ value, text: `${name} ${value} m`, level: "warn" });
  }
  const lines = linesOf(read, isSingle, (frame, index) => frame.altitude[index]);
  return { lines, spreads: spreadOf(read, isSingle, "altitude"), limits };
}
