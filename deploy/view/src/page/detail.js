// The card of a selected vehicle: its numbers, and what it receives of each peer.

import { byId, element, setText, show } from "./dom.js";
import * as format from "./format.js";
import { doing } from "./frame.js";
import { ageKind } from "./reception.js";

const DEGREES = 180 / Math.PI;

const vector = (values, decimals = 1) => (values ? values.map((value) => format.number(value, decimals)).join(", ") : "–");

/** A line about a fact that the server describes in `hello`. */
const factLine = ({ key, name, about, factor, decimals, unit }) => [name, about, ({ [key]: value }) => (
  Number.isFinite(value) ? `${format.number(value * factor, decimals)} ${unit}` : "–"
)];

/** Lines of the card: name, meaning and text. */
const linesOf = ({ facts }) => [
  ["position", "north and east of the origin", ({ ne_m }) => `N ${format.number(ne_m?.[0], 1)}  E ${format.number(ne_m?.[1], 1)} m`],
  ["altitude", "altitude above the origin, and its setpoint", ({ altitude_m, setpoint_altitude_m }) => (
    `${format.number(altitude_m, 1)} m, setpoint ${format.number(setpoint_altitude_m, 1)} m`
  )],
  ["velocity", "north, east, down", ({ velocity_ned_m_s }) => `${vector(velocity_ned_m_s)} m/s`],
  ["attitude", "roll, pitch, heading", ({ attitude_rad }) => {
    const [roll, pitch, heading] = (attitude_rad ?? []).map((angle) => angle * DEGREES);
    const turn = heading === undefined ? null : (heading + 360) % 360;
    return `${format.number(roll, 1)}°, ${format.number(pitch, 1)}°, ${format.number(turn)}°`;
  }],
  ["centre", "the centre that the vehicle flies around, north and east", ({ centre_ne_m, distance_m }) => (
    `N ${format.number(centre_ne_m?.[0])}  E ${format.number(centre_ne_m?.[1])}, ${format.number(distance_m, 1)} m away`
  )],
  ["field", "value of the formation field at the vehicle, north and east", ({ field_ne }) => vector(field_ne, 3)],
  ["error", "position error, north and east", ({ error_ne_m }) => `${vector(error_ne_m)} m`],
  ["controls", "roll, pitch, yaw, collective", ({ controls }) => vector(controls, 2)],
  ...facts.map(factLine),
  ["in formation", "for how long it has been at its altitude and in its place", ({ in_place_s }) => (
    Number.isFinite(in_place_s) ? `for ${format.number(in_place_s)} s` : "no"
  )],
  ["agent", "duration of a step: 99 of 100 are shorter", ({ step_p99_us }) => `step p99 ${format.number(step_p99_us)} µs`],
];

/** With more peers the matrix shows what the vehicle receives of each. */
const MOST_PEERS = 12;

export class Detail {
  /** `closed()` reports that the card was closed. */
  constructor({ closed }) {
    this.card = byId("detail");
    this.title = element("h2");
    const close = element("button", { type: "button", textContent: "×", title: "close (Esc)", attributes: { "aria-label": "close" } });
    close.addEventListener("click", closed);
    this.list = element("dl");
    this.peers = element("ul", { className: "peers" });
    this.card.append(element("header", {}, this.title, close), this.list, this.peers);
  }

  /** Begins with another swarm. */
  begin(swarm) {
    this.swarm = swarm;
    this.lines = linesOf(swarm).map(([name, title, of]) => ({ name, title, of, text: element("dd", { className: name }) }));
    this.list.replaceChildren(...this.lines.flatMap(({ name, title, text }) => [element("dt", { textContent: name, title }), text]));
  }

  draw({ frame, swarm, selected }) {
    const only = selected.size === 1 ? [...selected][0] : null;
    const vehicle = only === null ? null : frame.vehicle(only);
    show(this.card, Boolean(vehicle));
    if (!vehicle) return;
    const state = vehicle.contact === false ? `silent ${format.age(1000 * vehicle.silent_s)}, dead-reckoned` : doing(vehicle);
    setText(this.title, `Vehicle ${vehicle.id}: ${state ?? "–"}`);
    if (this.swarm !== swarm) this.begin(swarm);
    for (const { of, text } of this.lines) setText(text, of(vehicle));
    this.drawPeers(frame, swarm, only);
  }

  drawPeers(frame, swarm, index) {
    const row = frame.rowOf(index);
    show(this.peers, frame.members.length <= MOST_PEERS + 1);
    const size = frame.members.length;
    const texts = [];
    for (let sender = 0; sender < size; sender += 1) {
      const at = row * size + sender;
      if (sender === row || !frame.link[at]) continue;
      const kind = ageKind(frame.link[at], frame.age[at], swarm);
      texts.push([`${swarm.ids[frame.members[sender]]} ${kind === 5 ? "lost" : format.age(frame.age[at])}`, kind]);
    }
    while (this.peers.children.length > texts.length) this.peers.lastChild.remove();
    texts.forEach(([text, kind], at) => {
      const item = this.peers.children[at] ?? this.peers.appendChild(element("li"));
      setText(item, text);
      if (item.className !== `age-${kind}`) item.className = `age-${kind}`;
    });
  }
}
