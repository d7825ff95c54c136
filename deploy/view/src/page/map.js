// The map: north up, metres. Layers from the ground to the vehicles.

import { Camera, steer } from "./camera.js";
import { byId, contextOf, element, setText, show } from "./dom.js";
import * as format from "./format.js";
import { FAILED, doing } from "./frame.js";
import { drawCrowd, drawTeams } from "./map-crowd.js";
import { drawFence, drawFormation, drawGrid, drawMission, drawScale, drawUnknown } from "./map-ground.js";
import { drawLinks, drawPartitions } from "./map-links.js";
import { drawField, drawSeparations, drawTrails, drawVehicles } from "./map-vehicles.js";
import { ageLimits } from "./reception.js";
import { colours } from "./theme.js";

const PICK_PX = 18;
/** Layers that the user can hide, with their keys. */
const LAYERS = [["links", "l"], ["trails", "t"], ["field", "f"], ["mission", "g"]];

export class MapView {
  /** `chosen(index or null, isAdding)` reports a click, `changed()` that the map has to be drawn again. */
  constructor({ chosen, changed }) {
    this.canvas = byId("map");
    this.camera = new Camera();
    this.layers = Object.fromEntries(LAYERS.map(([name]) => [name, true]));
    this.changed = changed;
    this.frame = null;
    steer(this.canvas, this.camera, {
      changed,
      clicked: (x, y, isAdding) => chosen(this.pick(x, y), isAdding),
      hovered: (x, y) => this.point(x, y),
      left: () => this.point(null),
    });
    this.buttons = new Map(LAYERS.map(([name, key]) => {
      const button = element("button", {
        type: "button", textContent: name, title: `show or hide (${key})`, attributes: { "aria-pressed": "true" },
      });
      button.addEventListener("click", () => this.toggle(name));
      return [name, button];
    }));
    byId("layers").append(...this.buttons.values());
    byId("zoom-in").addEventListener("click", () => this.zoom(1.5));
    byId("zoom-out").addEventListener("click", () => this.zoom(1 / 1.5));
    byId("zoom-fit").addEventListener("click", () => this.fit());
  }

  /** Shows or hides a layer. */
  toggle(name) {
    this.layers[name] = !this.layers[name];
    this.buttons.get(name).setAttribute("aria-pressed", String(this.layers[name]));
    this.changed();
  }

  /** Toggles the layer with this key, if there is one. */
  toggleByKey(key) {
    const layer = LAYERS.find(([, own]) => own === key);
    if (layer) this.toggle(layer[0]);
    return Boolean(layer);
  }

  zoom(factor) {
    this.camera.zoom(factor);
    this.changed();
  }

  /** Shows all vehicles and follows them again. */
  fit() {
    this.camera.isAutomatic = true;
    this.isFitted = false;
    this.changed();
  }

  /** Moves a vehicle to the middle of the map. */
  centre(index) {
    if (!this.frame?.hasPosition(index)) return;
    this.camera.centre(this.frame.north[index], this.frame.east[index]);
    this.changed();
  }

  /** Begins with another swarm. */
  reset(swarm) {
    this.swarm = swarm;
    this.frame = null;
    this.fit();
    this.fillLegend(swarm);
  }

  fillLegend(swarm) {
    const kinds = ageLimits(swarm).map((text, at) => {
      const swatch = element("i", { className: `age age-${at + 1}` });
      return element("span", {}, swatch, text);
    });
    const title = element("b", {
      textContent: "newest message",
      title: "The half of a link at a vehicle shows how old the newest message is that it received from the other",
    });
    const crowd = [["good", "in place"], ["busy", "under way"], ["wrong", "failure"], ["gone", "no contact"]].map(
      ([name, text]) => element("span", {}, element("i", { className: `point ${name}` }), text),
    );
    byId("legend").replaceChildren(...(swarm.isLarge ? crowd : [title, ...kinds]));
  }

  /** The vehicle near a pixel, or `null`. */
  pick(x, y) {
    const { frame, camera } = this;
    if (!frame) return null;
    let [best, reach] = [null, PICK_PX];
    for (let index = 0; index < frame.north.length; index += 1) {
      const distance = Math.hypot(camera.x(frame.east[index]) - x, camera.y(frame.north[index]) - y);
      if (distance < reach) [best, reach] = [index, distance];
    }
    return best;
  }

  /** Shows what is under the mouse. */
  point(x, y) {
    this.mouse = x === null ? null : [x, y];
    this.showTip();
  }

  showTip() {
    const tip = byId("tip");
    if (!this.mouse || !this.frame) {
      show(tip, false);
      setText(byId("cursor"), "");
      return;
    }
    const [x, y] = this.mouse;
    const [north, east] = this.camera.place(x, y);
    const digits = this.camera.m_px < 1 ? 1 : 0;
    setText(byId("cursor"), `N ${format.number(north, digits)}  E ${format.number(east, digits)} m`);
    const index = this.pick(x, y);
    show(tip, index !== null);
    if (index === null) return;
    const { frame, swarm } = this;
    const vehicle = frame.vehicle(index);
    const altitude = `${format.number(frame.altitude[index], 1)} m high`;
    const state = frame.isInContact(index) ? (frame.flags[index] & FAILED ? "failure" : vehicle && doing(vehicle)) : "no contact";
    setText(tip, [`vehicle ${swarm.ids[index]}`, state, altitude].filter(Boolean).join(" · "));
    const { unit } = colours;
    tip.style.left = `${Math.min((x + 14) * unit, this.camera.width * unit - tip.offsetWidth - 6)}px`;
    tip.style.top = `${(y > 40 ? y - 34 : y + 18) * unit}px`;
  }

  /** Vehicles that the picture shows, at most so many; `null` if there are more. */
  visible(most) {
    const { frame, camera } = this;
    if (!frame) return [];
    const seen = [];
    for (let index = 0; index < frame.north.length; index += 1) {
      if (!camera.sees(frame.north[index], frame.east[index])) continue;
      seen.push(index);
      if (seen.length > most) return null;
    }
    return seen;
  }

  /** Draws a picture. Whether the view still moves. */
  draw({ frame, history, swarm, selected, reception }) {
    const ready = contextOf(this.canvas);
    if (!ready) return false;
    const { context, width, height } = ready;
    const { camera } = this;
    const isResized = camera.width !== width || camera.height !== height;
    Object.assign(camera, { width, height });
    this.frame = frame;
    if (frame && !frame.isUnknown && camera.isAutomatic) {
      const bounds = boundsOf(frame, swarm, this.layers.mission);
      if (bounds) {
        camera.show(bounds, !this.isFitted || isResized);
        this.isFitted = true;
      }
    }
    const isMoving = camera.step();
    drawGrid(context, camera);
    if (frame) this.drawSwarm(context, { frame, history, swarm, selected, reception });
    drawScale(context, camera);
    return isMoving;
  }

  drawSwarm(context, { frame, history, swarm, selected, reception }) {
    const { camera, layers } = this;
    drawFence(context, camera, swarm.scenario);
    if (swarm.teams.length > 1) {
      drawTeams(context, camera, frame, swarm);
    } else {
      const places = goals(frame, swarm);
      if (layers.mission) drawMission(context, camera, swarm.steps, frame.isUnknown ? -1 : (places[0]?.step ?? 0));
      places.forEach(({ centre, formation }, at) => drawFormation(context, camera, formation, centre, at > 0));
    }
    if (!swarm.isLarge) drawPartitions(context, camera, frame, swarm, reception.divided);
    if (frame.isUnknown) drawUnknown(context, camera);
    else if (layers.trails) drawTrails(context, camera, history, frame, swarm, selected);
    if (swarm.isLarge) drawCrowd(context, camera, frame, swarm);
    if (layers.links) drawLinks(context, camera, frame, swarm, selected);
    if (selected.size === 1 && layers.field) drawField(context, camera, frame, [...selected][0]);
    drawSeparations(context, camera, frame, swarm);
    drawVehicles(context, camera, frame, swarm, selected);
    if (this.mouse) this.showTip();
    this.canvas.setAttribute("aria-label", `map of ${swarm.name}, north up: ${frame.status?.text ?? ""}`);
  }
}

/** The places that the vehicles fly to, each with its formation, the most common first. */
export function goals(frame, swarm) {
  const found = new Map();
  for (const { step, centre_ne_m, contact, formation } of frame.rows) {
    if (!centre_ne_m || contact === false) continue;
    const key = [step, ...centre_ne_m.map((metres) => Math.round(metres / 2))].join();
    const entry = found.get(key) ?? { step, centre: centre_ne_m, formation: formation ?? swarm.formation(0, step), vehicles: 0 };
    entry.vehicles += 1;
    found.set(key, entry);
  }
  return [...found.values()].filter(({ formation }) => formation).sort((a, b) => b.vehicles - a.vehicles);
}

/** The bounds of all that matters, `[south, west, north, east]`, m; `null` if nothing has a position. */
function boundsOf(frame, swarm, hasMission) {
  const bounds = [Infinity, Infinity, -Infinity, -Infinity];
  const include = (north, east, radius = 0) => {
    bounds[0] = Math.min(bounds[0], north - radius);
    bounds[1] = Math.min(bounds[1], east - radius);
    bounds[2] = Math.max(bounds[2], north + radius);
    bounds[3] = Math.max(bounds[3], east + radius);
  };
  for (let index = 0; index < frame.north.length; index += 1) {
    if (frame.hasPosition(index)) include(frame.north[index], frame.east[index], 5);
  }
  if (swarm.teams.length < 2) {
    const reach = (formation) => (formation?.radius_m ?? 20) + (formation?.outer_width_m ?? 0);
    for (const { centre, formation } of goals(frame, swarm)) include(centre[0], centre[1], reach(formation));
    for (const { centre_ne_m, path_ne_m, formation } of hasMission ? swarm.steps : []) {
      for (const [north, east] of path_ne_m ?? (centre_ne_m ? [centre_ne_m] : [])) {
        include(north, east, 0.3 * reach(formation));
      }
    }
  }
  return Number.isFinite(bounds[0]) ? bounds : null;
}
