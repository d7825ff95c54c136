// A large swarm on the map: points, above them what is wrong, beneath them the density where points would cover each other.

import { AT_PLACE, CONTACT, FAILED, LANDED, teamCentre } from "./frame.js";
import { drawFormation } from "./map-ground.js";
import { colours, font } from "./theme.js";

const CELL_PX = 10;
/** Vehicles in a cell from which on it is shaded. */
const DENSE = 24;
/** Names of teams are drawn if no more than this many are in the picture. */
const NAMED_TEAMS = 80;

/** Draws the points of a large swarm; vehicles with details, which are drawn otherwise, are left out. */
export function drawCrowd(context, camera, frame, swarm) {
  const detailed = new Set(frame.members);
  const { north, east, flags } = frame;
  const size = Math.max(2, Math.min(7, 3 / Math.sqrt(camera.m_px / 4)));
  const half = size / 2;
  const columns = Math.ceil(camera.width / CELL_PX);
  const cells = new Uint16Array(columns * Math.ceil(camera.height / CELL_PX));
  const groups = { good: [], busy: [], wrong: [], lost: [] };
  for (let at = 0; at < north.length; at += 1) {
    const x = camera.x(east[at]);
    const y = camera.y(north[at]);
    if (!(x > -size && y > -size && x < camera.width + size && y < camera.height + size)) continue;
    if (x >= 0 && y >= 0 && x < camera.width && y < camera.height) {
      cells[Math.floor(y / CELL_PX) * columns + Math.floor(x / CELL_PX)] += 1;
    }
    if (detailed.has(at)) continue;
    const flag = flags[at];
    const isGood = flag & (AT_PLACE | LANDED);
    const group = !(flag & CONTACT) ? groups.lost : flag & FAILED ? groups.wrong : isGood ? groups.good : groups.busy;
    group.push(x, y);
  }
  shade(context, cells, columns);
  points(context, groups.busy, half, size, colours.accent);
  points(context, groups.good, half, size, colours.ok);
  points(context, groups.wrong, half + 1, size + 2, colours.warn);
  crosses(context, groups.lost, Math.max(3, size));
}

/** The density: the more vehicles a cell has, the brighter it is. */
function shade(context, cells, columns) {
  context.fillStyle = colours.accent;
  cells.forEach((vehicles, at) => {
    if (vehicles < DENSE) return;
    context.globalAlpha = Math.min(0.55, 0.08 * Math.log2(vehicles));
    context.fillRect((at % columns) * CELL_PX, Math.floor(at / columns) * CELL_PX, CELL_PX, CELL_PX);
  });
  context.globalAlpha = 1;
}

function points(context, list, half, size, colour) {
  context.fillStyle = colour;
  for (let at = 0; at < list.length; at += 2) context.fillRect(list[at] - half, list[at + 1] - half, size, size);
}

/** Vehicles out of contact are crosses, so that they differ in shape too. */
function crosses(context, list, arm) {
  context.strokeStyle = colours.bad;
  context.lineWidth = 1.5;
  context.beginPath();
  for (let at = 0; at < list.length; at += 2) {
    const [x, y] = [list[at], list[at + 1]];
    context.moveTo(x - arm, y - arm);
    context.lineTo(x + arm, y + arm);
    context.moveTo(x - arm, y + arm);
    context.lineTo(x + arm, y - arm);
  }
  context.stroke();
}

/** Draws the formations and names of the teams that are large enough in the picture. */
export function drawTeams(context, camera, frame, swarm) {
  if (swarm.teams.length < 2) return;
  const reported = new Map((frame.teams ?? []).map((team) => [team.id, team]));
  const seen = [];
  swarm.teams.forEach((team, at) => {
    const own = reported.get(team.id);
    const formation = own?.formation ?? swarm.formation(at, own?.step ?? 0);
    const centre = own?.centre_ne_m ?? teamCentre(frame, team);
    const radius = (formation?.radius_m ?? 0) / camera.m_px;
    if (centre && camera.sees(centre[0], centre[1], radius)) seen.push({ team, formation, centre, radius });
  });
  const isNamed = seen.length <= NAMED_TEAMS;
  context.font = font(0.8, 600);
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const { team, formation, centre, radius } of seen) {
    if (formation && radius > 10) drawFormation(context, camera, formation, centre, radius < 60);
    if (isNamed) {
      context.fillStyle = colours.muted;
      // Beneath a small ring, in the middle of a large one.
      const below = radius < 50 ? radius + 14 : 14;
      context.fillText(team.name ?? `team ${team.id}`, camera.x(centre[1]), camera.y(centre[0]) + below);
    }
  }
}
