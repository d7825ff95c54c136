// One picture of the swarm: what a snapshot of the server holds, in the order of the swarm's vehicles.

/** Status of a link: what the receiver has of the sender. */
export const NO_LINK = 0;
export const FRESH = 1;
export const STALE = 2;
export const LOST = 3;
const STATUS = { fresh: FRESH, stale: STALE, lost: LOST };

/** Flags of a vehicle, as in the binary positions. */
export const CONTACT = 1;
export const ACTIVE = 2;
export const AT_PLACE = 4;
export const FAILED = 8;
export const LANDED = 16;

/** The packed picture that was read last. */
let unpacked = { frame: null, rows: [] };

export class Frame {
  /** Reads a snapshot; `crowd` are the binary positions that came before it, if the swarm is large. */
  constructor(swarm, snapshot, crowd) {
    this.t_s = snapshot.t_s ?? null;
    /** Position in the history, s: the server's clock if live, else the time of the recording. */
    this.key = swarm.isLive ? (snapshot.at_ms ?? Date.now()) / 1000 : (snapshot.t_s ?? 0);
    this.isUnknown = false;
    this.status = snapshot.status ?? null;
    this.field = snapshot.field ?? null;
    this.teams = snapshot.teams ?? null;
    const known = (snapshot.vehicles ?? []).filter((vehicle) => swarm.index.has(String(vehicle.id)));
    this.rows = known;
    /** Distance that the safety filter keeps at that time, m: an operator may have changed it in flight. */
    this.isTuned = known.some(({ formation }) => formation);
    this.safety_m = known.find(({ formation }) => formation)?.formation.safety_distance_m ?? swarm.safety_m;
    /** Places in the swarm of those with details: all of a small swarm. */
    this.members = Int32Array.from(known, ({ id }) => swarm.index.get(String(id)));
    /** Place of the team of each of them. */
    this.memberTeams = Int32Array.from(this.members, (index) => swarm.teamIndex[index]);
    this.readLinks(swarm, known);
    this.readPositions(swarm, known, crowd);
    this.distance = Float32Array.from(known, ({ distance_m }) => distance_m ?? NaN);
    this.nearest = Float32Array.from(known, ({ nearest_m }) => nearest_m ?? NaN);
    for (const row of known) delete row.peers;
    this.summarise(swarm);
  }

  /** The picture of a time of which nothing was received: everything in it is unknown. */
  static unknown(swarm, key, t_s) {
    const vehicles = swarm.isLarge ? [] : swarm.ids.map((id) => ({ id, phase: "unknown" }));
    const status = { level: "none", text: "unknown: this page received nothing at this time", reasons: [] };
    const frame = new Frame(swarm, { t_s, at_ms: 1000 * key, status, vehicles }, null);
    frame.isUnknown = true;
    return frame;
  }

  /** Sums up what the plots of many vehicles show. */
  summarise(swarm) {
    if (swarm.vehicles.length <= SINGLE) return;
    const spread = swarm.isLarge ? distancesFromMiddle(this, swarm) : this.distance;
    this.spread = {
      distance: quartiles(spread),
      nearest: quartiles(this.nearest),
      altitude: quartiles(this.altitude),
      contact: share(this.flags, CONTACT),
      place: share(this.flags, AT_PLACE | LANDED),
    };
  }

  /** Vehicles with details, by the row of the table. */
  get rows() {
    if (typeof this.kept !== "string") return this.kept;
    if (unpacked.frame !== this) unpacked = { frame: this, rows: JSON.parse(this.kept) };
    return unpacked.rows;
  }

  set rows(rows) {
    this.kept = rows;
  }

  /** Makes an older picture small: its rows become one text. */
  pack() {
    if (typeof this.kept !== "string") this.kept = JSON.stringify(this.kept);
    this.field = null;
  }

  /** About how much memory this picture takes, bytes. */
  get bytes() {
    const rows = typeof this.kept === "string" ? this.kept.length : 1500 * this.kept.length;
    return rows + this.age.byteLength + this.link.byteLength + 17 * this.north.length;
  }

  /** Age and status of what each member has of each other: row receiver, column sender. */
  readLinks(swarm, known) {
    const size = known.length;
    const place = new Map(known.map(({ id }, at) => [String(id), at]));
    this.age = new Float32Array(size * size).fill(NaN);
    this.link = new Uint8Array(size * size);
    known.forEach((vehicle, receiver) => {
      for (const [id, age_ms, status] of vehicle.peers ?? []) {
        const sender = place.get(String(id));
        if (sender === undefined || sender === receiver) continue;
        this.age[receiver * size + sender] = age_ms ?? NaN;
        this.link[receiver * size + sender] = STATUS[status] ?? LOST;
      }
    });
  }

  readPositions(swarm, known, crowd) {
    const size = swarm.vehicles.length;
    if (crowd && crowd.north.length === size) {
      Object.assign(this, {
        north: crowd.north, east: crowd.east, altitude: crowd.altitude, heading: crowd.heading, flags: crowd.flags,
      });
      return;
    }
    const values = () => new Float32Array(size).fill(NaN);
    Object.assign(this, { north: values(), east: values(), altitude: values(), heading: values() });
    this.flags = new Uint8Array(size);
    known.forEach((vehicle, row) => {
      const at = this.members[row];
      this.north[at] = vehicle.ne_m?.[0] ?? NaN;
      this.east[at] = vehicle.ne_m?.[1] ?? NaN;
      this.altitude[at] = vehicle.altitude_m ?? NaN;
      this.heading[at] = vehicle.attitude_rad?.[2] ?? 0;
      this.flags[at] = flagsOf(vehicle);
    });
  }

  /** Row of the vehicle at this place of the swarm, or −1. */
  rowOf(index) {
    return this.members.indexOf(index);
  }

  /** Details of the vehicle at this place of the swarm, if the picture has them. */
  vehicle(index) {
    const row = this.rowOf(index);
    return row < 0 ? null : this.rows[row];
  }

  isInContact(index) {
    return (this.flags[index] & CONTACT) !== 0;
  }

  hasPosition(index) {
    return Number.isFinite(this.north[index]) && Number.isFinite(this.east[index]);
  }
}

/** Swarms with more vehicles are plotted as a spread instead of single lines. */
export const SINGLE = 12;

/** Vehicles sampled for quartiles: more do not change the picture. */
const SAMPLED = 500;

/** Least, lower quartile, median, upper quartile and largest of the finite values; `null` without any. */
function quartiles(values) {
  const every = Math.max(1, Math.floor(values.length / SAMPLED));
  let [least, most] = [Infinity, -Infinity];
  const sample = [];
  values.forEach((value, at) => {
    if (!Number.isFinite(value)) return;
    if (value < least) least = value;
    if (value > most) most = value;
    if (at % every === 0) sample.push(value);
  });
  if (sample.length === 0) return null;
  const sorted = Float32Array.from(sample).sort();
  const at = (part) => sorted[Math.round(part * (sorted.length - 1))];
  return [least, at(0.25), at(0.5), at(0.75), most];
}

/** Share of vehicles with any of these flags, percent. */
function share(flags, wanted) {
  let found = 0;
  for (const flag of flags) if (flag & wanted) found += 1;
  return (100 * found) / Math.max(1, flags.length);
}

/** Middle of a team: the mean of its vehicles, m north and east; `null` without positions. */
export function teamCentre(frame, team) {
  let [north, east, known] = [0, 0, 0];
  for (const index of team.members) {
    if (!frame.hasPosition(index)) continue;
    north += frame.north[index];
    east += frame.east[index];
    known += 1;
  }
  return known ? [north / known, east / known] : null;
}

/** Distance of each vehicle from the middle of its team, m. */
function distancesFromMiddle(frame, swarm) {
  const distances = new Float32Array(frame.north.length).fill(NaN);
  for (const team of swarm.teams) {
    const middle = teamCentre(frame, team);
    if (!middle) continue;
    for (const index of team.members) {
      distances[index] = Math.hypot(frame.north[index] - middle[0], frame.east[index] - middle[1]);
    }
  }
  return distances;
}

/** What the vehicle does: its phase, and in the phase formation whether it is in its place. */
export function doing({ phase, in_place_s }) {
  if (phase !== "formation") return phase ?? "–";
  return Number.isFinite(in_place_s) ? phase : "under way";
}

function flagsOf(vehicle) {
  const flags = [
    [vehicle.contact, CONTACT],
    [vehicle.membership === "active", ACTIVE],
    [Number.isFinite(vehicle.in_place_s) || vehicle.phase === "landed", AT_PLACE],
    [vehicle.failures?.length > 0, FAILED],
    [vehicle.phase === "landed", LANDED],
  ];
  return flags.reduce((all, [isSet, flag]) => (isSet ? all | flag : all), 0);
}
