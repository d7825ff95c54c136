// A row for each vehicle; above a hundred vehicles a row for each team and for the vehicles with details.

import { byId, element, setClass, setText, show } from "./dom.js";
import { AT_PLACE, CONTACT, FAILED, LANDED, doing } from "./frame.js";
import * as format from "./format.js";
import { separationLevel } from "./map-vehicles.js";
import { vehicleColour } from "./theme.js";

const oldest = (frame, row) => {
  const size = frame.members.length;
  let most = null;
  for (let sender = 0; sender < size; sender += 1) {
    const link = frame.link[row * size + sender];
    if (link === 1 || link === 2) most = Math.max(most ?? 0, frame.age[row * size + sender]);
  }
  return most;
};

const lowRate = (rate) => (rate === null || rate === undefined || rate >= 45 ? "" : rate < 30 ? "bad" : "warn");

/** Columns of a vehicle: title, meaning, text and level of its cell. */
const COLUMNS = [
  ["phase", "what the vehicle does: formation (at its altitude and in its place), under way (not there); for a silent one how long it is out of contact", (vehicle) => [
    vehicle.contact === false ? `silent ${format.age(1000 * vehicle.silent_s)}` : doing(vehicle),
    vehicle.contact === false ? "bad" : vehicle.phase === "blind" ? "warn" : "",
  ], "name"],
  ["faults, orders", "failures that the vehicle detected, and the order that it follows", ({ failures, order }) => [
    [...(failures ?? []), order ? `order: ${order}` : ""].filter(Boolean).join("; "), failures?.length ? "bad" : "",
  ], "name wide"],
  ["step", "mission step, and the highest step whose goal the vehicle itself reached", ({ step, reached }) => [
    `${format.number(step)} / ${format.number(reached)}`,
  ]],
  ["live", "active members in contact, in this vehicle's view, itself included", ({ live }) => [format.number(live)]],
  ["alt m", "altitude above the origin", ({ altitude_m }) => [format.number(altitude_m, 1)]],
  ["centre m", "distance from the formation's centre", ({ distance_m }) => [format.number(distance_m, 1)]],
  ["gap °", "angle to the next vehicle around the centre, and its difference from an even gap",
    ({ gap_deg, gap_error_deg }) => [
      gap_deg === null || gap_deg === undefined
        ? "–"
        : `${format.number(gap_deg, 1)} ${format.signed(gap_error_deg, 1)}`,
    ]],
  ["near m", "distance of the nearest vehicle", ({ nearest_m }, { swarm, frame }) => [
    format.number(nearest_m, 1), separationLevel(nearest_m ?? null, swarm, frame).replace("ok", ""),
  ]],
  ["Hz", "frames a second", ({ frame_rate_hz }) => [format.number(frame_rate_hz, 1), lowRate(frame_rate_hz)]],
  ["jitter ms", "deviation of the frames from their period", ({ jitter_ms }) => [format.number(jitter_ms, 1)]],
  ["late", "steps that missed their deadline", ({ overruns }) => [format.number(overruns), overruns > 0 ? "warn" : ""]],
  ["oldest ms", "age of the oldest newest message of a peer in contact", (vehicle, { frame, row, swarm }) => {
    const ms = oldest(frame, row);
    return [format.number(ms), ms > swarm.stale_ms ? "warn" : ""];
  }],
  ["refused", "messages that the agent refused: malformed, implausible, of a wrong sender", ({ refused }) => [
    format.number(refused), refused > 0 ? "warn" : "",
  ]],
  ["unsent", "own messages that the agent did not send because the network was too slow", ({ unsent }) => [
    format.number(unsent), unsent > 0 ? "warn" : "",
  ]],
];

/** Columns of a team. */
const TEAM_COLUMNS = [
  ["vehicles", "vehicles of the team", (found) => [String(found.all)]],
  ["contact", "vehicles in contact", (found) => [format.number(found.contact), found.contact < found.all ? "bad" : ""]],
  ["in place", "vehicles in formation or landed", (found) => [format.number(found.place)]],
  ["failures", "vehicles with a failure", (found) => [format.number(found.failed), found.failed ? "warn" : ""]],
  ["alt m", "mean altitude", (found) => [format.number(found.altitude, 1)]],
];

const MOST_TEAMS = 100;

export class Table {
  /** `chosen(indices, isAdding)` reports a click. */
  constructor({ chosen }) {
    this.head = byId("table").tHead;
    this.body = byId("table").tBodies[0];
    this.rows = new Map();
    this.chosen = chosen;
    this.isOfTeams = null;
  }

  /** Begins with another swarm. */
  reset() {
    this.rows.clear();
    this.body.replaceChildren();
    this.isOfTeams = null;
  }

  draw({ frame, swarm, selected }) {
    const isOfTeams = swarm.isLarge && swarm.teams.length > 1 && selected.size === 0;
    if (isOfTeams !== this.isOfTeams) {
      this.reset();
      this.isOfTeams = isOfTeams;
      const columns = isOfTeams ? TEAM_COLUMNS : COLUMNS;
      const heads = columns.map(([text, title, , kind]) => element("th", { textContent: text, title, className: kind ?? "" }));
      const first = element("th", { textContent: isOfTeams ? "team" : "id", className: "id" });
      this.head.replaceChildren(element("tr", {}, first, ...heads));
    }
    if (isOfTeams) this.drawTeams(frame, swarm);
    else this.drawVehicles(frame, swarm, selected);
    const note = byId("table-note");
    show(note, swarm.isLarge);
    if (swarm.isLarge) setText(note, noteOf(frame, swarm, isOfTeams));
  }

  drawVehicles(frame, swarm, selected) {
    const rows = frame.rows;
    const present = new Set();
    // A row that was seen once stays, in the order of the ids.
    const order = [...frame.members.keys()];
    for (const row of order) {
      const index = frame.members[row];
      const vehicle = rows[row];
      present.add(index);
      const line = this.line(index, COLUMNS, swarm.ids[index], vehicleColour(swarm, index), [index]);
      const isGone = vehicle.contact === false;
      setClass(line.row, `${selected.has(index) ? "selected" : ""} ${isGone ? "gone" : ""}`.trim());
      line.row.setAttribute("aria-selected", String(selected.has(index)));
      fill(line, COLUMNS, vehicle, { swarm, frame, row });
    }
    if (swarm.isLarge) this.keepOnly(present);
  }

  drawTeams(frame, swarm) {
    const found = swarm.teams.map((team, at) => ({ team, at, ...sumUp(frame, team) }));
    // Those with something wrong come first.
    found.sort((a, b) => b.all - b.contact + b.failed - (a.all - a.contact + a.failed) || a.at - b.at);
    const shown = found.slice(0, MOST_TEAMS);
    this.keepOnly(new Set(shown.map(({ at }) => at)));
    shown.forEach((sum, place) => {
      const name = sum.team.name ?? `team ${sum.team.id}`;
      const colour = vehicleColour(swarm, sum.team.members[0]);
      const line = this.line(sum.at, TEAM_COLUMNS, name, colour, sum.team.members.slice(0, 64));
      if (this.body.rows[place] !== line.row) this.body.insertBefore(line.row, this.body.rows[place] ?? null);
      fill(line, TEAM_COLUMNS, sum, {});
    });
  }

  keepOnly(keys) {
    for (const [key, { row }] of this.rows) {
      if (keys.has(key)) continue;
      row.remove();
      this.rows.delete(key);
    }
  }

  line(key, columns, name, colour, indices) {
    let line = this.rows.get(key);
    if (!line) {
      const swatch = element("i", { className: "swatch" });
      const head = element("th", { className: "id", attributes: { scope: "row" } }, swatch, name);
      const cells = columns.map(([, , , kind]) => element("td", { className: kind ?? "" }));
      const row = element("tr", {}, head, ...cells);
      row.dataset.vehicle = name;
      row.addEventListener("click", (event) => this.chosen(indices, event.shiftKey || event.ctrlKey || event.metaKey));
      this.body.append(row);
      line = { row, cells, swatch, kinds: columns.map(([, , , kind]) => kind ?? "") };
      this.rows.set(key, line);
    }
    if (line.colour !== colour) {
      line.swatch.style.background = colour;
      line.colour = colour;
    }
    return line;
  }
}

function fill(line, columns, value, context) {
  columns.forEach(([, , of], at) => {
    const [text, level] = of(value, context);
    setText(line.cells[at], text);
    setClass(line.cells[at], `${line.kinds[at]} ${level ?? ""}`.trim());
  });
}

function sumUp(frame, team) {
  if (frame.isUnknown) return { all: team.members.length, contact: NaN, place: NaN, failed: NaN, altitude: null };
  const sum = { all: team.members.length, contact: 0, place: 0, failed: 0, altitude: null };
  const altitudes = team.members.map((index) => frame.altitude[index]).filter(Number.isFinite);
  if (altitudes.length) sum.altitude = altitudes.reduce((total, altitude) => total + altitude, 0) / altitudes.length;
  for (const index of team.members) {
    const flags = frame.flags[index];
    if (flags & CONTACT) sum.contact += 1;
    if (flags & (AT_PLACE | LANDED)) sum.place += 1;
    if (flags & FAILED) sum.failed += 1;
  }
  return sum;
}

function noteOf(frame, swarm, isOfTeams) {
  if (isOfTeams) {
    const more = swarm.teams.length > MOST_TEAMS ? `The first ${MOST_TEAMS} of ${swarm.teams.length} teams. ` : "";
    return `${more}A click on a team shows its vehicles.`;
  }
  const all = swarm.vehicles.length.toLocaleString("en");
  return frame.members.length
    ? `${frame.members.length} of ${all} vehicles. Esc shows all again.`
    : `${all} vehicles. Zoom in or click a vehicle to see its row.`;
}
