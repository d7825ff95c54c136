// The lowest layers of the map: grid, fence, obstacles, mission and formation.

import { colours, font } from "./theme.js";
import * as format from "./format.js";

/** Draws the grid and north. */
export function drawGrid(context, camera) {
  const rem = colours.rem;
  const step_m = format.tickStep(camera.m_px * Math.max(camera.width, camera.height), 9);
  const [north, west] = camera.place(0, 0);
  const [south, east] = camera.place(camera.width, camera.height);
  context.lineWidth = 1;
  context.strokeStyle = colours.line;
  context.beginPath();
  for (let at = Math.ceil(west / step_m) * step_m; at <= east; at += step_m) {
    const x = Math.round(camera.x(at)) + 0.5;
    context.moveTo(x, 0);
    context.lineTo(x, camera.height);
  }
  for (let at = Math.ceil(south / step_m) * step_m; at <= north; at += step_m) {
    const y = Math.round(camera.y(at)) + 0.5;
    context.moveTo(0, y);
    context.lineTo(camera.width, y);
  }
  context.stroke();
  // The numbers stand at the upper and the right edge, away from the scale and the legend.
  context.fillStyle = colours.faint;
  context.font = font(0.72);
  context.textBaseline = "top";
  context.textAlign = "left";
  for (let at = Math.ceil(west / step_m) * step_m; at <= east; at += step_m) {
    const x = camera.x(at);
    if (x > 17 * rem && x < camera.width - 4 * rem) context.fillText(axisText(at), x + 4, 4);
  }
  context.textAlign = "right";
  context.textBaseline = "bottom";
  for (let at = Math.ceil(south / step_m) * step_m; at <= north; at += step_m) {
    const y = camera.y(at);
    if (y > 5.5 * rem && y < camera.height - 3 * rem) context.fillText(axisText(at), camera.width - 5, y - 2);
  }
  drawNorth(context, camera.width - 1.4 * rem, 2.1 * rem);
}

function axisText(at) {
  const metres = Math.abs(at) < 1e-6 ? 0 : at;
  return Math.abs(metres) >= 10_000 ? Math.round(metres).toLocaleString("en").replace("-", "−") : format.number(metres);
}

function drawNorth(context, x, y) {
  const rem = colours.rem;
  context.fillStyle = colours.muted;
  context.beginPath();
  context.moveTo(x, y - 0.9 * rem);
  context.lineTo(x + 0.4 * rem, y + 0.3 * rem);
  context.lineTo(x, y);
  context.lineTo(x - 0.4 * rem, y + 0.3 * rem);
  context.fill();
  context.font = font(0.75, 600);
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillText("N", x, y + 0.4 * rem);
}

/** Draws the scale, beside which the style sheet keeps the legend. */
export function drawScale(context, camera) {
  const rem = colours.rem;
  const most_m = Math.min(0.25 * camera.width, 10 * rem) * camera.m_px;
  const power = 10 ** Math.floor(Math.log10(most_m));
  const step_m = [5, 2, 1].map((factor) => factor * power).find((step) => step <= most_m) ?? power;
  const length = step_m / camera.m_px;
  const [x, y] = [camera.width - 1.2 * rem - length, camera.height - 1.1 * rem];
  context.strokeStyle = colours.muted;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(x, y - 4);
  context.lineTo(x, y);
  context.lineTo(x + length, y);
  context.lineTo(x + length, y - 4);
  context.stroke();
  context.fillStyle = colours.muted;
  context.font = font(0.78);
  context.textAlign = "center";
  context.textBaseline = "bottom";
  const text = `${step_m.toLocaleString("en")} m`;
  context.strokeStyle = colours.ground;
  context.lineWidth = 3;
  context.strokeText(text, x + length / 2, y - 4);
  context.fillText(text, x + length / 2, y - 4);
}

function trace(context, camera, points, isClosed) {
  context.beginPath();
  points.forEach(([north, east], at) => {
    if (at === 0) context.moveTo(camera.x(east), camera.y(north));
    else context.lineTo(camera.x(east), camera.y(north));
  });
  if (isClosed) context.closePath();
}

/** Draws the fence that no vehicle may leave, and the obstacles. */
export function drawFence(context, camera, scenario) {
  const airspace = scenario.airspace ?? {};
  const fence = airspace.fence_ne_m;
  if (fence?.length > 2) {
    trace(context, camera, fence, true);
    context.setLineDash([10, 4, 2, 4]);
    context.lineWidth = 1.5;
    context.strokeStyle = colours.bad;
    context.stroke();
    context.setLineDash([]);
  }
  for (const { centre_ne_m: [north, east], size_ne_m: size, radius_m } of airspace.obstacles ?? []) {
    if (size) {
      const corners = [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]];
      trace(context, camera, corners.map(([up, right]) => [north + up * size[0], east + right * size[1]]), true);
    } else {
      context.beginPath();
      context.arc(camera.x(east), camera.y(north), radius_m / camera.m_px, 0, 2 * Math.PI);
    }
    context.fillStyle = colours.line;
    context.fill();
    context.strokeStyle = colours.muted;
    context.lineWidth = 1;
    context.stroke();
  }
}

/** Draws the places and paths of a mission; `step` is the present one. */
export function drawMission(context, camera, steps, step) {
  const centres = steps.map(({ centre_ne_m, path_ne_m }) => centre_ne_m ?? path_ne_m?.at(-1) ?? null);
  context.strokeStyle = colours.muted;
  context.globalAlpha = 0.6;
  context.lineWidth = 1.2;
  const way = [];
  steps.forEach(({ path_ne_m }, at) => {
    if (path_ne_m) way.push(...path_ne_m);
    else if (centres[at]) way.push(centres[at]);
  });
  if (way.length > 1) {
    trace(context, camera, way, false);
    context.setLineDash([2, 5]);
    context.stroke();
    context.setLineDash([]);
  }
  context.globalAlpha = 1;
  const places = new Map();
  centres.forEach((centre, at) => {
    if (!centre) return;
    const key = centre.join();
    places.set(key, { centre, steps: [...(places.get(key)?.steps ?? []), at] });
  });
  if (places.size < 2) return;
  context.font = font(0.75);
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const { centre, steps: here } of places.values()) {
    const [x, y] = [camera.x(centre[1]), camera.y(centre[0])];
    const isPresent = here.includes(step);
    const isPast = Math.max(...here) < step;
    context.fillStyle = isPresent ? colours.text : colours.muted;
    context.strokeStyle = context.fillStyle;
    context.beginPath();
    context.arc(x, y, 3, 0, 2 * Math.PI);
    if (isPast || isPresent) context.fill();
    else context.stroke();
    const names = here.map((at) => (steps[at].name ? `${at} ${steps[at].name}` : String(at)));
    context.fillText(names.join(" · "), x, y + 6);
  }
}

/** The points of the level curve `x² + γ y² = ρ²` around a centre, turned by the formation's heading, m north and east. */
export function levelCurve(centre, rho, formation, points = 96) {
  const heading = ((formation.heading_deg ?? 0) * Math.PI) / 180;
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  const narrow = Math.sqrt(formation.gamma > 0 ? formation.gamma : 1);
  return Array.from({ length: points }, (_, at) => {
    const angle = (2 * Math.PI * at) / points;
    const [x, y] = [rho * Math.cos(angle), (rho * Math.sin(angle)) / narrow];
    return [centre[0] + x * cos - y * sin, centre[1] + x * sin + y * cos];
  });
}

/** Draws a formation: its band, its ring and its centre. */
export function drawFormation(context, camera, formation, centre, isFaint) {
  const radius = formation.radius_m;
  if (!(radius > 0)) return;
  const isBand = formation.law !== "flock" && formation.inner_width_m > 0 && formation.outer_width_m > 0;
  context.globalAlpha = isFaint ? 0.5 : 1;
  context.fillStyle = colours.band;
  if (isBand) {
    const outer = levelCurve(centre, radius + formation.outer_width_m, formation);
    const inner = levelCurve(centre, Math.max(0, radius - formation.inner_width_m), formation).reverse();
    context.beginPath();
    for (const curve of [outer, inner]) {
      curve.forEach(([north, east], at) => {
        if (at === 0) context.moveTo(camera.x(east), camera.y(north));
        else context.lineTo(camera.x(east), camera.y(north));
      });
      context.closePath();
    }
    context.fill();
  }
  trace(context, camera, levelCurve(centre, radius, formation), true);
  if (formation.law === "flock") context.fill();
  context.strokeStyle = colours.ring;
  context.lineWidth = 1.3;
  context.setLineDash([6, 5]);
  context.stroke();
  context.setLineDash([]);
  const [x, y] = [camera.x(centre[1]), camera.y(centre[0])];
  context.beginPath();
  context.moveTo(x - 6, y);
  context.lineTo(x + 6, y);
  context.moveTo(x, y - 6);
  context.lineTo(x, y + 6);
  context.stroke();
  context.globalAlpha = 1;
}

/** Draws that nothing is known of the time of the picture. */
export function drawUnknown(context, camera) {
  context.font = font(1.05, 600);
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = colours.muted;
  context.fillText("nothing was received at this time", camera.width / 2, camera.height / 2);
}
