// Events and faults as they come; the same event of several vehicles is one line.

import { byId, element, setText } from "./dom.js";
import * as format from "./format.js";

/** The same event of another vehicle within this time joins the line, s. */
const TOGETHER_S = 5;
const MOST_LINES = 200;
const MOST_EVENTS = 20_000;

export class Events {
  /** `seek(t)` reports a click on a line. */
  constructor({ seek }) {
    this.list = byId("events");
    this.seek = seek;
    this.reset();
  }

  reset() {
    this.all = [];
    this.shown = "";
    this.list.replaceChildren();
  }

  /** Takes up all events so far. */
  replace(events) {
    this.all = [];
    events.forEach((event) => this.add(event));
  }

  add({ t_s, at_ms, vehicle, text, level }) {
    const event = { t_s: t_s ?? null, arrived: (at_ms ?? Date.now()) / 1000, vehicle: String(vehicle ?? ""), text: String(text), level };
    this.all.push(event);
    if (this.all.length > MOST_EVENTS) this.all.shift();
    this.version = (this.version ?? 0) + 1;
  }

  /** When an event was, as a key of the history. */
  key(event, history) {
    const offset = history.offset_s;
    return event.t_s === null || offset === null ? event.arrived : event.t_s + offset;
  }

  /** When an event was in the flight, s; `null` if that is not known. */
  time(event, history) {
    if (event.t_s !== null || history.offset_s === null) return event.t_s;
    return event.arrived - history.offset_s;
  }

  /** Draws the events up to the time of the picture; of selected vehicles only, if there are some. */
  draw({ history, player, swarm, selected }) {
    const until = player.position + 0.5;
    const chosen = new Set([...selected].map((index) => swarm.ids[index]));
    const seen = this.all.filter((event) => this.key(event, history) <= until && concerns(event, chosen));
    const offset = history.offset_s;
    // Before a first time of flight was received, the times of events are not known.
    const shown = [this.version, seen.length, offset === null ? "" : Math.round(offset), ...chosen].join();
    if (shown === this.shown) return;
    this.shown = shown;
    setText(byId("events-filter"), chosen.size ? `of ${format.ids(chosen, 4)}` : "");
    const lines = grouped(seen, (event) => this.key(event, history)).slice(-MOST_LINES).reverse();
    this.list.replaceChildren(...lines.map((line) => this.line(line, swarm, history)));
  }

  line({ first, vehicles, objects, text, level }, swarm, history) {
    const who = vehicles.size === 1 ? [...vehicles][0] : null;
    const [subject] = who === null ? [format.count(vehicles.size, "vehicle")] : [who ? `vehicle ${who}` : swarm.name];
    const plural = vehicles.size > 1 ? inPlural(text) : text;
    const object = objects.size > 1 ? plural.replace(/vehicle \S+$/, format.count(objects.size, "vehicle")) : plural;
    const line = element(
      "li", { className: level, title: vehicles.size > 1 ? `vehicles ${format.ids(vehicles)}` : "" },
      element("time", { textContent: format.time(this.time(first, history)) }),
      element("b", { textContent: subject }), " ", element("span", { textContent: object }),
    );
    line.addEventListener("click", () => this.seek(this.key(first, history)));
    return line;
  }
}

/** The text of an event with several vehicles as its subject: `continue to step 1`. */
function inPlural(text) {
  return text.replace(/^(accept|continue|hold|skip|wait|land)s\b/, "$1");
}

function concerns({ vehicle, text }, chosen) {
  if (chosen.size === 0 || chosen.has(vehicle)) return true;
  const other = /vehicle (\S+)$/.exec(text)?.[1];
  return other !== undefined && chosen.has(other);
}

/** Joins the same events of several vehicles, also those about several other vehicles; `keyOf(event)` is when it was. */
export function grouped(events, keyOf) {
  const lines = [];
  const open = new Map();
  for (const event of events) {
    const key = `${event.level} ${event.text.replace(/vehicle \S+$/, "vehicle")}`;
    const t = keyOf(event);
    let line = open.get(key);
    if (!line || Math.abs(t - line.last) > TOGETHER_S) {
      line = { first: event, vehicles: new Set(), objects: new Set(), text: event.text, level: event.level };
      lines.push(line);
      open.set(key, line);
    }
    line.last = t;
    line.vehicles.add(event.vehicle);
    const object = /vehicle (\S+)$/.exec(event.text)?.[1];
    if (object) line.objects.add(object);
  }
  return lines;
}
