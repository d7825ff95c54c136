// The links of the map: each vehicle's half of a line shows how old the newest message is that it received over it.

import { thin } from "./dom.js";
import { LOST, NO_LINK } from "./frame.js";
import { ageKind } from "./reception.js";
import { colours, font } from "./theme.js";
import * as format from "./format.js";

/** With more vehicles only what is wrong has arrowheads, and what is lost both ways is left out. */
const FEW = 10;
/** Most links that are drawn as wide lines. */
const MOST_WIDE = 45;

/** Draws the links between vehicles with details. Selected vehicles have theirs in full, the others faintly. */
export function drawLinks(context, camera, frame, swarm, selected) {
  const size = frame.members.length;
  if (size < 2) return;
  const isFew = size <= FEW;
  const chosen = frame.members.map((index) => (selected.has(index) ? 1 : 0));
  const isAnyChosen = chosen.includes(1);
  const halves = [[], [], [], [], [], []];
  const dimmed = [[], [], [], [], [], []];
  for (let receiver = 0; receiver < size; receiver += 1) {
    const own = frame.members[receiver];
    // What a vehicle out of contact receives is unknown.
    if (!frame.isInContact(own) || !frame.hasPosition(own)) continue;
    const [x, y] = [camera.x(frame.east[own]), camera.y(frame.north[own])];
    for (let sender = 0; sender < size; sender += 1) {
      const link = frame.link[receiver * size + sender];
      const peer = frame.members[sender];
      if (link === NO_LINK || !frame.hasPosition(peer)) continue;
      const back = frame.link[sender * size + receiver];
      const isOneWay = frame.isInContact(peer) && (link === LOST) !== (back === LOST) && back !== NO_LINK;
      const isChosen = isAnyChosen && (chosen[receiver] || chosen[sender]);
      if (link === LOST && !isFew && !isOneWay && !isChosen) continue;
      const kind = ageKind(link, frame.age[receiver * size + sender], swarm);
      const peer_x = camera.x(frame.east[peer]);
      const peer_y = camera.y(frame.north[peer]);
      const isPlain = !isFew && kind < 4 && !isChosen && !isOneWay;
      const target = (isAnyChosen ? isChosen : isFew || !isPlain) ? halves : dimmed;
      target[kind].push(x, y, (x + peer_x) / 2, (y + peer_y) / 2);
    }
  }
  const faint = isAnyChosen ? 0.12 : Math.max(0.08, Math.min(0.5, 5 / size));
  drawDimmed(context, camera, frame, dimmed, faint);
  halves.forEach((lines, kind) => stroke(context, lines, kind, 1, true));
}

/** The faint links of the picture drawn last, as an image. */
const image = { canvas: null, key: "" };

/**
 * Draws the faint links. Those of a swarm of fifty take longer than all the rest of the map, so they are drawn twice a second
 * into an image, or when the view moves.
 */
function drawDimmed(context, camera, frame, dimmed, faint) {
  const draw = (target) => dimmed.forEach((lines, kind) => stroke(target, lines, kind, faint, false));
  if (frame.members.length <= FEW) {
    draw(context);
    return;
  }
  const { width, height } = context.canvas;
  const view = [camera.north, camera.east, camera.m_px, width, height, colours.unit];
  const key = [...view, faint, colours.ages, Math.floor(2 * frame.key)].join();
  if (key !== image.key) {
    image.key = key;
    image.canvas ??= document.createElement("canvas");
    Object.assign(image.canvas, { width, height });
    const target = image.canvas.getContext("2d");
    target.setTransform(context.getTransform());
    draw(target);
  }
  context.drawImage(image.canvas, 0, 0, camera.width, camera.height);
}

function stroke(context, lines, kind, alpha, hasHeads) {
  if (lines.length === 0) return;
  const isBad = kind >= 4;
  context.globalAlpha = alpha;
  context.strokeStyle = colours.ages[kind];
  context.fillStyle = colours.ages[kind];
  // A large swarm has thousands of links.
  context.lineWidth = lines.length > 4 * MOST_WIDE ? thin() : isBad && hasHeads ? 2.2 : 1.8;
  context.setLineDash(kind === 5 ? [3, 5] : kind === 4 ? [9, 4] : []);
  context.beginPath();
  for (let at = 0; at < lines.length; at += 4) {
    context.moveTo(lines[at], lines[at + 1]);
    context.lineTo(lines[at + 2], lines[at + 3]);
  }
  context.stroke();
  context.setLineDash([]);
  if (hasHeads) {
    context.beginPath();
    for (let at = 0; at < lines.length; at += 4) head(context, lines, at, kind);
    if (kind === 5) context.stroke();
    else context.fill();
  }
  context.globalAlpha = 1;
}

/** An arrow that ends at the receiver; a bar across a lost link. */
function head(context, lines, at, kind) {
  const [x, y, to_x, to_y] = [lines[at], lines[at + 1], lines[at + 2], lines[at + 3]];
  const length = Math.hypot(to_x - x, to_y - y);
  if (length < 30) return;
  const [ux, uy] = [(to_x - x) / length, (to_y - y) / length];
  if (kind === 5) {
    const [px, py] = [x + 0.55 * length * ux, y + 0.55 * length * uy];
    context.moveTo(px - 6 * uy, py + 6 * ux);
    context.lineTo(px + 6 * uy, py - 6 * ux);
    return;
  }
  const [px, py] = [x + 1.25 * colours.rem * ux, y + 1.25 * colours.rem * uy];
  context.moveTo(px, py);
  context.lineTo(px + 8 * ux - 3.6 * uy, py + 8 * uy + 3.6 * ux);
  context.lineTo(px + 8 * ux + 3.6 * uy, py + 8 * uy - 3.6 * ux);
}

/** Colours of partitions: not those of the links. */
const partitionColour = (number) => colours.vehicles[[4, 3, 5, 2, 7][number % 5]];

/** Draws the partitions of a divided swarm: a halo around each vehicle, and the partitions by name. */
export function drawPartitions(context, camera, frame, swarm, partitions) {
  if (partitions.length < 2) return;
  const rem = colours.rem;
  const places = partitions.map((rows) => rows
    .map((row) => frame.members[row])
    .filter((index) => frame.hasPosition(index))
    .map((index) => [camera.x(frame.east[index]), camera.y(frame.north[index])]));
  const radius = (frame.members.length > 30 ? 1.15 : 1.55) * rem;
  places.forEach((points, number) => {
    context.fillStyle = partitionColour(number);
    context.strokeStyle = partitionColour(number);
    context.lineWidth = 1.6;
    context.setLineDash(number % 2 ? [4, 4] : []);
    for (const [x, y] of points) {
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.globalAlpha = 0.16;
      context.fill();
      context.globalAlpha = 1;
      context.stroke();
    }
    context.setLineDash([]);
  });
  nameThem(context, camera, frame, swarm, partitions);
}

function nameThem(context, camera, frame, swarm, partitions) {
  const rem = colours.rem;
  context.font = font(0.85, 600);
  context.textAlign = "left";
  context.textBaseline = "middle";
  partitions.slice(0, 6).forEach((rows, number) => {
    const ids = rows.map((row) => swarm.ids[frame.members[row]]);
    const [x, y] = [4.4 * rem, (3.9 + 1.7 * number) * rem];
    context.strokeStyle = partitionColour(number);
    context.lineWidth = 2;
    context.setLineDash(number % 2 ? [4, 4] : []);
    context.beginPath();
    context.arc(x, y, 0.5 * rem, 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
    context.fillStyle = colours.text;
    context.fillText(`partition ${number + 1}: ${format.ids(ids, 8)}`, x + rem, y);
  });
}
