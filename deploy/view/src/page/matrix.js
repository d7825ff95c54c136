// The matrix of who receives whom: a row for each receiver, a column for each sender, the age of the newest message as colour.

import { byId, contextOf, pointIn, show } from "./dom.js";
import { LOST, NO_LINK } from "./frame.js";
import * as format from "./format.js";
import { ageKind } from "./reception.js";
import { colours, font } from "./theme.js";

export class Matrix {
  /** `chosen(index, isAdding)` reports a click on a receiver. */
  constructor({ chosen }) {
    this.canvas = byId("matrix");
    this.canvas.addEventListener("click", (event) => {
      const cell = this.cellAt(event);
      if (cell) chosen(this.frame.members[cell.receiver], event.shiftKey || event.ctrlKey || event.metaKey);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      this.canvas.title = this.describe(this.cellAt(event));
    });
  }

  cellAt(event) {
    if (!this.frame || !this.cell) return null;
    const [x, y] = pointIn(this.canvas, event);
    const column = Math.floor((x - this.left) / this.cell);
    const row = Math.floor((y - this.top) / this.cell);
    const [receiver, sender] = [this.order[row], this.order[column]];
    return receiver === undefined || sender === undefined ? null : { receiver, sender };
  }

  describe(cell) {
    const { frame, swarm } = this;
    if (!cell || cell.receiver === cell.sender || frame.isUnknown) return "";
    const at = cell.receiver * frame.members.length + cell.sender;
    const [receiver, sender] = [cell.receiver, cell.sender].map((row) => swarm.ids[frame.members[row]]);
    if (!frame.isInContact(frame.members[cell.receiver])) return `${receiver} is out of contact`;
    if (frame.link[at] === NO_LINK) return `${receiver} receives nothing of ${sender}`;
    const kind = ["", "fresh", "stale", "lost"][frame.link[at]];
    return `${receiver} receives ${sender}: ${format.age(frame.age[at])}, ${kind}`;
  }

  draw({ frame, swarm, selected, reception }) {
    this.swarm = swarm;
    this.frame = frame;
    show(byId("matrix-box"), frame.members.length > 1);
    const ready = contextOf(this.canvas);
    const size = frame.members.length;
    if (!ready || size < 2) return;
    const { context, width, height } = ready;
    // Members of a partition stand together, so that a divided swarm shows as blocks.
    const grouped = reception.divided.flat();
    const rest = Array.from({ length: size }, (_, at) => at).filter((at) => !grouped.includes(at));
    this.order = [...grouped, ...rest];
    const rem = colours.rem;
    this.names = namesOf(frame, swarm);
    context.font = font(0.75, 600);
    this.nameWidth = Math.max(...this.names.map((name) => context.measureText(name).width));
    this.left = this.nameWidth + 2 * rem;
    this.top = 2.2 * rem;
    this.cell = Math.min((width - this.left) / size, (height - this.top) / size, 3.4 * rem);
    this.drawCells(context, selected);
    this.drawAxes(context, selected);
  }

  drawCells(context, selected) {
    const { frame, swarm, order, cell, left, top } = this;
    const size = order.length;
    const gap = cell > 8 ? 1.5 : cell > 4 ? 0.75 : 0;
    const hasText = cell > 1.8 * colours.rem;
    context.font = font(Math.min(0.85, cell / colours.rem / 2.9), 600);
    context.textAlign = "center";
    context.textBaseline = "middle";
    order.forEach((receiver, row) => {
      const isKnown = frame.isInContact(frame.members[receiver]);
      order.forEach((sender, column) => {
        if (receiver === sender) return;
        const at = receiver * size + sender;
        const kind = isKnown ? ageKind(frame.link[at], frame.age[at], swarm) : 0;
        const [x, y] = [left + column * cell, top + row * cell];
        context.fillStyle = kind ? colours.ages[kind] : colours.line;
        context.globalAlpha = kind || !isKnown ? 1 : 0.5;
        context.fillRect(x, y, cell - gap, cell - gap);
        context.globalAlpha = 1;
        if (frame.link[at] === LOST && isKnown && cell > 6) strike(context, x, y, cell - gap);
        if (hasText && kind && frame.link[at] !== LOST) {
          context.fillStyle = colours.age_ink;
          const ms = frame.age[at];
          context.fillText(ms < 1000 ? String(Math.round(ms)) : format.age(ms), x + cell / 2, y + cell / 2);
        }
      });
    });
    for (const row of order.keys()) {
      if (!selected.has(frame.members[order[row]])) continue;
      context.strokeStyle = colours.text;
      context.lineWidth = 1.5;
      context.strokeRect(left - 1, top + row * cell - 1, size * cell, cell);
    }
  }

  drawAxes(context, selected) {
    const { frame, order, names, cell, left, top } = this;
    const rem = colours.rem;
    context.fillStyle = colours.muted;
    context.font = font(0.72);
    context.textAlign = "left";
    context.textBaseline = "top";
    context.fillText("sender →", left, 0);
    context.save();
    context.translate(0, top + 4.6 * rem);
    context.rotate(-Math.PI / 2);
    context.fillText("← receiver", 0, 0);
    context.restore();
    const everyColumn = Math.max(1, Math.ceil((this.nameWidth + 5) / cell));
    const everyRow = Math.max(1, Math.ceil((0.95 * rem) / cell));
    context.font = font(0.75, 600);
    order.forEach((member, at) => {
      context.fillStyle = selected.has(frame.members[member]) ? colours.text : colours.muted;
      if (at % everyColumn === 0) {
        context.textAlign = "center";
        context.textBaseline = "bottom";
        context.fillText(names[member], left + (at + 0.5) * cell, top - 3);
      }
      if (at % everyRow === 0) {
        context.textAlign = "right";
        context.textBaseline = "middle";
        context.fillText(names[member], left - 5, top + (at + 0.5) * cell);
      }
    });
  }
}

/** Names of the members: those of a single team need not name it. */
function namesOf(frame, swarm) {
  const members = [...frame.members];
  const isOneTeam = new Set(members.map((index) => swarm.teamIndex[index])).size === 1;
  return members.map((index) => (isOneTeam ? swarm.ids[index].replace(/^.*\//, "") : swarm.ids[index]));
}

/** A cross in the cell of a lost link: it differs from a stale one in shape too. */
function strike(context, x, y, size) {
  context.strokeStyle = colours.age_ink;
  context.lineWidth = Math.min(2, Math.max(1, size / 12));
  const margin = size * 0.3;
  context.beginPath();
  context.moveTo(x + margin, y + margin);
  context.lineTo(x + size - margin, y + size - margin);
  context.moveTo(x + size - margin, y + margin);
  context.lineTo(x + margin, y + size - margin);
  context.stroke();
}
