// The line that reports how the swarm is, and the banner that reports why nothing can be shown.

import { byId, element, setText, show } from "./dom.js";

const MARKS = { ok: "●", warn: "▲", bad: "■", none: "○" };
const MOST_REASONS = 4;

/** Shows the status of a picture, if there is one: its level as colour and shape, its text, its reasons. */
export function drawStatus(frame) {
  const level = frame?.status?.level in MARKS ? frame.status.level : "none";
  const box = byId("status");
  if (box.dataset.level !== level) box.dataset.level = level;
  setText(byId("status-mark"), MARKS[level]);
  setText(byId("status-text"), frame?.status?.text ?? "waiting for the vehicles");
  const reasons = frame?.status?.reasons ?? [];
  const shown = reasons.slice(0, MOST_REASONS).map(String);
  if (reasons.length > MOST_REASONS) shown.push(`and ${reasons.length - MOST_REASONS} more`);
  const list = byId("status-reasons");
  const text = shown.join("\n");
  if (list.dataset.text === text) return;
  list.dataset.text = text;
  list.title = reasons.join("\n");
  list.replaceChildren(...shown.map((reason) => element("li", { textContent: reason })));
}

/** What keeps the page from showing the swarm; the newest of each kind is kept until it is over. */
export class Banner {
  constructor() {
    this.problems = new Map();
  }

  /** Whether there is a problem of this kind. */
  has(kind) {
    return this.problems.has(kind);
  }

  /** Sets the problem of a kind, `{ text, remedy }`, or ends it with `null`. */
  set(kind, problem) {
    if (problem) this.problems.set(kind, problem);
    else this.problems.delete(kind);
    const first = [...this.problems.values()][0];
    show(byId("banner"), Boolean(first));
    setText(byId("banner-text"), first?.text ?? "");
    setText(byId("banner-remedy"), first?.remedy ?? "");
  }
}
