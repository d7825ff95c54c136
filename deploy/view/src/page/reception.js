// Who receives whom: partitions, cuts and one-way links of a picture.

import { FRESH, LOST, NO_LINK, STALE } from "./frame.js";
import * as format from "./format.js";

/** Kinds of links by age, as coloured: 1 to 3 fresh, 4 stale, 5 lost, 0 no link. */
export function ageKind(link, age_ms, swarm) {
  if (link === NO_LINK) return 0;
  if (link === LOST) return 5;
  if (link === STALE || age_ms > swarm.stale_ms) return 4;
  if (age_ms <= 0.2 * swarm.stale_ms) return 1;
  return age_ms <= 0.5 * swarm.stale_ms ? 2 : 3;
}

/** The largest age of each kind, as the legend shows it. */
export function ageLimits(swarm) {
  const upTo = (ms) => `≤ ${format.age(ms)}`;
  return [
    upTo(0.2 * swarm.stale_ms), upTo(0.5 * swarm.stale_ms), upTo(swarm.stale_ms), `stale, ${upTo(swarm.lost_ms)}`, "lost",
  ];
}

/**
 * What the links of a picture amount to. All numbers are rows of the picture's details:
 * `partitions` groups of vehicles in contact with each other, `divided` those of teams that have several (a vehicle receives its own
 * team only: teams are no partitions of a fleet), `oneWay` pairs `[receiver, sender]` of which the sender
 * receives nothing back, `silent` vehicles out of contact, `open` and `lost` numbers of links, `oldest` the oldest message
 * of an open link.
 */
export function analyse(frame) {
  const size = frame.members.length;
  const present = Array.from(frame.members, (index) => frame.isInContact(index));
  const isOpen = (receiver, sender) => {
    const link = frame.link[receiver * size + sender];
    return link === FRESH || link === STALE;
  };
  const group = Array.from({ length: size }, (_, at) => at);
  const rootOf = (at) => {
    let root = at;
    while (group[root] !== root) root = group[root];
    group[at] = root;
    return root;
  };
  const found = { partitions: [], divided: [], oneWay: [], silent: [], open: 0, lost: 0, oldest: null };
  for (let receiver = 0; receiver < size; receiver += 1) {
    if (!present[receiver]) {
      found.silent.push(receiver);
      continue;
    }
    for (let sender = 0; sender < size; sender += 1) {
      if (sender === receiver || !present[sender]) continue;
      const link = frame.link[receiver * size + sender];
      if (link === LOST) {
        found.lost += 1;
        if (isOpen(sender, receiver)) found.oneWay.push([sender, receiver]);
      }
      if (!isOpen(receiver, sender)) continue;
      found.open += 1;
      group[rootOf(receiver)] = rootOf(sender);
      const age_ms = frame.age[receiver * size + sender];
      if (!found.oldest || age_ms > found.oldest.age_ms) found.oldest = { age_ms, receiver, sender };
    }
  }
  const groups = new Map();
  for (let at = 0; at < size; at += 1) {
    if (!present[at]) continue;
    const root = rootOf(at);
    groups.set(root, [...(groups.get(root) ?? []), at]);
  }
  // Before the first messages there is nothing to be divided.
  found.partitions = found.open > 0 || found.lost > 0 ? [...groups.values()] : [];
  found.divided = byTeam(found.partitions, frame).filter(([, parts]) => parts.length > 1).flatMap(([, parts]) => parts);
  return found;
}

/** Partitions by the place of their team: `[team, partitions]`. */
function byTeam(partitions, frame) {
  const found = new Map();
  for (const rows of partitions) {
    const team = frame.memberTeams[rows[0]];
    found.set(team, [...(found.get(team) ?? []), rows]);
  }
  return [...found];
}

/** The analysis in a sentence, with the level of its colour. */
export function describe(found, frame, swarm) {
  const id = (row) => swarm.ids[frame.members[row]];
  const silent = found.silent.length ? ` · no contact with ${format.ids(found.silent.map(id), 6)}` : "";
  const level = found.silent.length ? "warn" : "ok";
  if (frame.isUnknown) return { level: "none", text: "unknown" };
  if (frame.members.length === 0) return { level: "none", text: "" };
  if (found.partitions.length === 0) {
    return { level: silent ? level : "none", text: `no messages between vehicles${silent}` };
  }
  if (found.divided.length > 0) {
    const texts = byTeam(found.divided, frame).map(([team, parts]) => {
      const name = swarm.teams.length > 1 ? `${swarm.teams[team].name ?? `team ${swarm.teams[team].id}`}: ` : "";
      return `${name}${parts.length} partitions: ${parts.map((rows) => format.ids(rows.map(id), 8)).join(" | ")}`;
    });
    return { level: "bad", text: `${texts.join("; ")}${silent}` };
  }
  if (found.oneWay.length > 0) {
    const [receiver, sender] = found.oneWay[0];
    const more = found.oneWay.length > 1 ? `, and ${found.oneWay.length - 1} more` : "";
    return { level: "warn", text: `one way: ${id(receiver)} receives ${id(sender)}, not the reverse${more}${silent}` };
  }
  if (found.lost > 0) return { level: "warn", text: `${found.open} links open, ${found.lost} lost${silent}` };
  const { age_ms, receiver, sender } = found.oldest;
  const oldest = `oldest message ${format.age(age_ms)}, from ${id(sender)} at ${id(receiver)}`;
  const pairs = found.partitions.reduce((sum, { length }) => sum + length * (length - 1), 0);
  const isComplete = found.open === pairs;
  const within = swarm.teams.length > 1 ? " of their team" : "";
  const complete = found.silent.length ? "the others receive each other" : `all receive all${within}`;
  return { level, text: `${isComplete ? complete : `${found.open} links open`} · ${oldest}${silent}` };
}
