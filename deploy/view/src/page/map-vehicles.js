// The vehicles of the map: trails, helicopters, ghosts of lost vehicles, separations and the field of a selected one.

import { thin } from "./dom.js";
import { FAILED, LANDED } from "./frame.js";
import { colours, font, vehicleColour } from "./theme.js";
import * as format from "./format.js";

const TRAIL_S = 60;
/** Parts of a trail, each fainter than the next. */
const TRAIL_PARTS = 5;

/** Draws where each vehicle was in the last minute; older parts are fainter. */
export function drawTrails(context, camera, history, frame, swarm, selected) {
  const from = frame.key - TRAIL_S;
  const all = history.between(from, frame.key);
  const every = Math.max(1, Math.ceil(all.length / (swarm.vehicles.length > 20 ? 60 : 150)));
  const frames = all.filter((one, at) => at % every === 0 || one === frame);
  if (frames.length < 2) return;
  const isAnyChosen = selected.size > 0;
  context.lineWidth = 1.6;
  context.lineJoin = "round";
  for (let part = 0; part < TRAIL_PARTS; part += 1) {
    const least = from + (TRAIL_S * part) / TRAIL_PARTS;
    const most = from + (TRAIL_S * (part + 1)) / TRAIL_PARTS;
    const first = Math.max(0, frames.findIndex(({ key }) => key >= least) - 1);
    const end = frames.findIndex(({ key }) => key > most);
    const points = frames.slice(first, end < 0 ? frames.length : end + 1);
    const strength = (0.55 * (part + 1)) / TRAIL_PARTS;
    for (const index of frame.members) {
      context.strokeStyle = vehicleColour(swarm, index);
      context.globalAlpha = isAnyChosen && !selected.has(index) ? 0.3 * strength : strength;
      context.beginPath();
      let isDown = false;
      let before = null;
      for (const { key, north, east } of points) {
        if (before !== null && history.isBroken(before, key)) isDown = false;
        before = key;
        if (!Number.isFinite(north[index])) {
          isDown = false;
          continue;
        }
        const [x, y] = [camera.x(east[index]), camera.y(north[index])];
        if (isDown) context.lineTo(x, y);
        else context.moveTo(x, y);
        isDown = true;
      }
      context.stroke();
    }
  }
  context.globalAlpha = 1;
}

/** Draws the nearest pair, and every pair nearer than 1.5 times the safety distance, coloured against the limits. */
export function drawSeparations(context, camera, frame, swarm) {
  const limit = frame.safety_m ?? 2 * swarm.collision_m;
  const { members } = frame;
  let nearest = null;
  const close = [];
  for (let one = 0; one < members.length; one += 1) {
    for (let two = one + 1; two < members.length; two += 1) {
      const [a, b] = [members[one], members[two]];
      if ((frame.flags[a] | frame.flags[b]) & LANDED) continue;
      const distance = separation(frame, a, b);
      if (!(distance >= 0)) continue;
      if (distance < 1.5 * limit) close.push([distance, a, b]);
      if (!nearest || distance < nearest[0]) nearest = [distance, a, b];
    }
  }
  if (nearest && !close.length) close.push(nearest);
  context.font = font(0.75, 600);
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const [distance, a, b] of close.slice(0, 60)) {
    const level = separationLevel(distance, swarm, frame);
    context.strokeStyle = { ok: colours.muted, warn: colours.warn, bad: colours.bad }[level];
    context.lineWidth = level === "ok" ? 1 : 3;
    context.setLineDash(level === "ok" ? [1, 4] : []);
    const [ax, ay, bx, by] = [
      camera.x(frame.east[a]), camera.y(frame.north[a]), camera.x(frame.east[b]), camera.y(frame.north[b]),
    ];
    context.beginPath();
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
    context.stroke();
    context.setLineDash([]);
    if (Math.hypot(bx - ax, by - ay) > 4 * colours.rem || level !== "ok") {
      plate(context, format.metres(distance), (ax + bx) / 2, (ay + by) / 2, context.strokeStyle);
    }
  }
}

/** Distance of two vehicles in space, m. */
export function separation(frame, a, b) {
  const vertical = frame.altitude[a] - frame.altitude[b];
  return Math.hypot(
    frame.north[a] - frame.north[b], frame.east[a] - frame.east[b], Number.isFinite(vertical) ? vertical : 0,
  );
}

/** How a separation is against the limits of collision and safety at the time of the picture. */
export function separationLevel(distance, swarm, { safety_m }) {
  if (distance === null || !Number.isFinite(distance)) return "ok";
  if (distance < (safety_m ?? swarm.collision_m)) return "bad";
  return distance < 1.5 * (safety_m ?? 2 * swarm.collision_m) ? "warn" : "ok";
}

/** A text on a plate of the ground's colour, so that lines beneath do not disturb it. */
function plate(context, text, x, y, colour) {
  const width = context.measureText(text).width + 6;
  const height = 1.15 * colours.rem;
  context.fillStyle = colours.ground;
  context.globalAlpha = 0.8;
  context.fillRect(x - width / 2, y - height / 2, width, height);
  context.globalAlpha = 1;
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** Draws the vehicles with details: safety circle, helicopter with its heading or ghost, and id. */
export function drawVehicles(context, camera, frame, swarm, selected) {
  const rows = frame.rows;
  const radius = frame.safety_m ? frame.safety_m / 2 / camera.m_px : 0;
  const isCrowded = frame.members.length > 30;
  frame.members.forEach((index, row) => {
    if (!frame.hasPosition(index) || !camera.sees(frame.north[index], frame.east[index], 40)) return;
    const [x, y] = [camera.x(frame.east[index]), camera.y(frame.north[index])];
    const isChosen = selected.has(index);
    const colour = vehicleColour(swarm, index);
    if (radius > 9 && !(frame.flags[index] & LANDED)) {
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.strokeStyle = colours.muted;
      context.lineWidth = 1;
      context.setLineDash([2, 3]);
      context.stroke();
      context.setLineDash([]);
    }
    if (isChosen) ringAround(context, x, y);
    if (frame.isInContact(index)) {
      helicopter(context, x, y, frame.heading[index], colour, isCrowded ? 0.8 : 1, frame.flags[index]);
    } else {
      ghost(context, x, y, colour);
    }
    label(context, x, y, swarm.ids[index], rows[row], isChosen, isCrowded);
  });
}

function ringAround(context, x, y) {
  context.beginPath();
  context.arc(x, y, 1.35 * colours.rem, 0, 2 * Math.PI);
  context.strokeStyle = colours.text;
  context.lineWidth = 1.5;
  context.stroke();
}

/** A helicopter from above: rotor disc, body, tail boom and tail rotor; the nose points along its heading. */
function helicopter(context, x, y, heading, colour, size, flags) {
  const unit = size * colours.rem * 0.095;
  context.save();
  context.translate(x, y);
  context.rotate(Number.isFinite(heading) ? heading : 0);
  context.scale(unit, unit);
  if (!(flags & LANDED)) {
    context.beginPath();
    context.arc(0, 0, 9.5, 0, 2 * Math.PI);
    context.globalAlpha = 0.28;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = colour;
    context.lineWidth = 0.7;
    context.stroke();
  }
  context.beginPath();
  context.moveTo(0, -7);
  context.bezierCurveTo(3.4, -6.4, 4.6, -1, 2.4, 3);
  context.lineTo(0.9, 5);
  context.lineTo(0.8, 11.5);
  context.lineTo(3.2, 11.8);
  context.lineTo(3.2, 13.6);
  context.lineTo(-3.2, 13.6);
  context.lineTo(-3.2, 11.8);
  context.lineTo(-0.8, 11.5);
  context.lineTo(-0.9, 5);
  context.lineTo(-2.4, 3);
  context.bezierCurveTo(-4.6, -1, -3.4, -6.4, 0, -7);
  context.strokeStyle = colours.ground;
  context.lineWidth = 2.5;
  context.stroke();
  context.fillStyle = colour;
  context.fill();
  context.restore();
  if (flags & FAILED) cross(context, x + 9, y - 9);
}

/** A mark of a failure. */
function cross(context, x, y) {
  context.strokeStyle = colours.bad;
  context.lineWidth = 2.5;
  context.beginPath();
  context.moveTo(x - 4, y - 4);
  context.lineTo(x + 4, y + 4);
  context.moveTo(x - 4, y + 4);
  context.lineTo(x + 4, y - 4);
  context.stroke();
}

/** A vehicle out of contact: a hatched disc where dead reckoning puts it. */
function ghost(context, x, y, colour) {
  const radius = 0.85 * colours.rem;
  context.save();
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = colours.ground;
  context.fill();
  context.clip();
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.beginPath();
  for (let at = -2 * radius; at <= 2 * radius; at += 4.5) {
    context.moveTo(x + at - radius, y + radius);
    context.lineTo(x + at + radius, y - radius);
  }
  context.stroke();
  context.restore();
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.strokeStyle = colours.bad;
  context.lineWidth = 2;
  context.setLineDash([4, 3]);
  context.stroke();
  context.setLineDash([]);
}

function label(context, x, y, id, vehicle, isChosen, isCrowded) {
  const isSilent = vehicle && vehicle.contact === false;
  const text = isSilent ? `${id} · silent ${format.age(1000 * vehicle.silent_s)}` : id;
  context.font = font(isCrowded && !isChosen ? 0.75 : 0.9, 600);
  context.textAlign = "left";
  context.textBaseline = "middle";
  const [tx, ty] = [x + 0.9 * colours.rem, y - 0.95 * colours.rem];
  context.strokeStyle = colours.ground;
  context.lineWidth = 3.5;
  context.lineJoin = "round";
  context.strokeText(text, tx, ty);
  context.fillStyle = isSilent ? colours.bad : colours.text;
  context.fillText(text, tx, ty);
}

/** Draws the field of the selected vehicle as arrows: the grid that the server computed, and the vehicle's own value. */
export function drawField(context, camera, frame, index) {
  const vehicle = frame.vehicle(index);
  if (!vehicle || !frame.hasPosition(index)) return;
  const grid = frame.field;
  if (grid && String(grid.vehicle) === String(vehicle.id)) {
    const spacing = Math.abs((grid.east_m[1] ?? 0) - (grid.east_m[0] ?? 0)) / camera.m_px;
    const longest = Math.max(6, 0.8 * spacing);
    context.strokeStyle = colours.field;
    context.lineWidth = thin();
    context.beginPath();
    const most = fullSize(grid.ne);
    grid.north_m.forEach((north, row) => {
      grid.east_m.forEach((east, column) => {
        const value = grid.ne[row * grid.east_m.length + column];
        if (value) arrow(context, camera.x(east), camera.y(north), value, most, longest, 0.3);
      });
    });
    context.stroke();
  }
  if (vehicle.field_ne) {
    context.strokeStyle = colours.text;
    context.lineWidth = 2.4;
    context.beginPath();
    const most = grid ? fullSize(grid.ne) : 1;
    arrow(context, camera.x(frame.east[index]), camera.y(frame.north[index]), vehicle.field_ne, most, 4 * colours.rem, 0.25);
    context.stroke();
  }
}

/** The magnitude of an arrow of full length: 1 for a field without unit; the largest of a law that commands m or m/s. */
function fullSize(values) {
  return values.reduce((most, value) => Math.max(most, Math.hypot(...value)), 1);
}

/** An arrow along a value of the field. Magnitudes from `most` on have the full length. */
function arrow(context, x, y, [north, east], most, longest, tip) {
  const size = Math.hypot(north, east);
  if (!(size > 1e-4)) return;
  // The root makes the weak field near the ring visible.
  const length = Math.sqrt(Math.min(1, size / most)) * longest;
  const [dx, dy] = [(east / size) * length, (-north / size) * length];
  const [to_x, to_y] = [x + dx, y + dy];
  context.moveTo(x, y);
  context.lineTo(to_x, to_y);
  context.moveTo(to_x - tip * (dx + 0.6 * dy), to_y - tip * (dy - 0.6 * dx));
  context.lineTo(to_x, to_y);
  context.lineTo(to_x - tip * (dx - 0.6 * dy), to_y - tip * (dy + 0.6 * dx));
}
