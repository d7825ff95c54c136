// A server of the page's protocol that plays a synthetic swarm: for looking at the page, and for tests of what a real flight
// does not show on demand. `node mock.mjs --vehicles 50 --port 7480`.

import { createReadStream, existsSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { WebSocketServer } from "ws";

const PAGE = fileURLToPath(new URL("../../deploy/view/src/page/", import.meta.url));
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };
const CSP = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
  + "base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/** What `[airspace]` of a scenario says. */
const AIRSPACE = {
  fence_ne_m: [[-400, -400], [-400, 400], [400, 500], [400, -400]], ceiling_m: 60, floor_m: 10, margin_m: 10,
  obstacles: [
    { centre_ne_m: [250, -150], radius_m: 40, size_ne_m: null, top_m: null },
    { centre_ne_m: [-200, 200], radius_m: null, size_ne_m: [60, 120], top_m: 20 },
  ],
};

/** A repeatable random number from 0 to 1. */
function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

/** A swarm whose vehicles slide onto a ring and space themselves evenly. */
export class MockSwarm {
  constructor({ vehicles = 4, teams = 1, gamma = 1, steps = null } = {}) {
    const next = random(7);
    this.perTeam = Math.ceil(vehicles / teams);
    this.teams = teams;
    this.radius = Math.max(60, teams > 1 ? 192 : Math.min(100 + vehicles * 1.5, 2000));
    this.gamma = gamma;
    this.side = Math.ceil(Math.sqrt(teams));
    this.vehicles = Array.from({ length: vehicles }, (_, at) => {
      const team = Math.floor(at / this.perTeam);
      const number = (at % this.perTeam) + 1;
      const spread = teams > 1 ? 150 : Math.max(150, 15 * Math.sqrt(vehicles) * 2);
      return {
        id: teams > 1 ? `${team + 1}/${number}` : String(number), team: teams > 1 ? team + 1 : null, number,
        place: [Math.floor(team / this.side) * 2000, (team % this.side) * 2000],
        ne: [(next() - 0.5) * spread, (next() - 0.5) * spread], v: [0, 0], altitude: 0, heading: next() * 6.28,
        isAlive: true, silent_s: 0, failures: [], jitter: next(), step: 0, reached: null,
      };
    });
    this.blocked = () => false;
    this.events = [];
    this.t_s = 0;
    this.steps = steps ?? [
      { name: "gather", kind: "centre", centre_ne_m: [0, 0], formation: this.formation(0) },
      { name: "gate", kind: "centre", centre_ne_m: [1.8 * this.radius, 0], formation: this.formation(30) },
      { name: "home", kind: "centre", centre_ne_m: [0, 1.2 * this.radius], formation: this.formation(0) },
      { name: null, kind: "land", centre_ne_m: null, formation: null },
    ];
  }

  formation(heading_deg) {
    return { law: "ring", radius_m: this.radius, gamma: this.gamma, heading_deg, inner_width_m: 20, outer_width_m: 20, altitude_m: 30 };
  }

  hello(source, extra = {}) {
    return {
      type: "hello", version: 1, source, swarm: "mock", title: "mock", orders: false, duration_s: 400, from_s: 0, to_s: 400,
      vehicles: this.vehicles.map(({ id, team, number }) => ({ id, team, number })),
      facts: [{ key: "energy_left", name: "energy", about: "share of the battery that is left", factor: 100, decimals: 0, unit: "% left" }],
      teams: this.teams > 1 ? Array.from({ length: this.teams }, (_, at) => ({ id: at + 1, name: null })) : [],
      scenario: {
        name: "mock", law: "ring", plant: "builtin", vehicles: this.vehicles.length, safety_distance_m: 8, collision_distance_m: 2,
        even: true, airspace: AIRSPACE, network: { stale_s: 0.5, lost_s: 2 }, steps: this.steps,
      },
      ...extra,
    };
  }

  event(vehicle, text, level = "info") {
    this.events.push({ type: "event", t_s: this.t_s, vehicle, text, level });
    return this.events.at(-1);
  }

  kill(id) {
    const vehicle = this.vehicles.find((one) => one.id === id);
    vehicle.isAlive = false;
    vehicle.silent_s = 0;
    this.vehicles.filter((one) => one !== vehicle).forEach((one) => this.event(one.id, `lost contact with vehicle ${id}`, "warn"));
  }

  cut(side, isBothWays = true) {
    const inside = new Set(side);
    this.cut_s = this.t_s;
    this.blocked = (receiver, sender) => (isBothWays
      ? inside.has(receiver) !== inside.has(sender) : inside.has(receiver) && !inside.has(sender));
  }

  advance(dt) {
    this.t_s += dt;
    const groups = new Map();
    for (const vehicle of this.vehicles) {
      if (vehicle.isAlive) groups.set(vehicle.team, [...(groups.get(vehicle.team) ?? []), vehicle]);
      else vehicle.silent_s += dt;
    }
    const step = this.teams > 1 ? 0 : this.t_s > 90 ? 1 : 0;
    for (const group of groups.values()) {
      const centre = this.teams > 1 ? [Math.min(1000, this.t_s * 2), 0] : this.steps[step].centre_ne_m;
      const angles = group.map(({ ne }) => Math.atan2(ne[1] - centre[1], ne[0] - centre[0]));
      const order = [...angles.keys()].sort((a, b) => angles[a] - angles[b]);
      const even = (2 * Math.PI) / group.length;
      order.forEach((at, place) => {
        const vehicle = group[at];
        const gap = (to) => (angles[order[(to + group.length) % group.length]] - angles[at] + 4 * Math.PI) % (2 * Math.PI) || 2 * Math.PI;
        const ahead = gap(place + 1);
        const behind = 2 * Math.PI - gap(place - 1);
        vehicle.gap = (ahead * 180) / Math.PI;
        vehicle.gap_error = ((ahead - even) * 180) / Math.PI;
        this.move(vehicle, centre, angles[at], (ahead - behind) / 2, dt, step);
      });
    }
  }

  move(vehicle, centre, angle, swing, dt, step) {
    const radius = this.radius + 6 * Math.sin(this.t_s / 11 + vehicle.jitter * 9);
    const target = [centre[0] + radius * Math.cos(angle + swing), centre[1] + (radius / Math.sqrt(this.gamma)) * Math.sin(angle + swing)];
    const want = [0, 1].map((axis) => Math.max(-5, Math.min(5, 0.12 * (target[axis] - vehicle.ne[axis]))));
    vehicle.v = [0, 1].map((axis) => vehicle.v[axis] + Math.min(1, dt * 1.2) * (want[axis] - vehicle.v[axis]));
    vehicle.ne = [0, 1].map((axis) => vehicle.ne[axis] + dt * vehicle.v[axis]);
    vehicle.altitude += dt * Math.max(-1.5, Math.min(2, 30 - vehicle.altitude));
    vehicle.centre = centre;
    vehicle.distance = Math.hypot(vehicle.ne[0] - centre[0], vehicle.ne[1] - centre[1]);
    if (vehicle.step !== step) {
      vehicle.step = step;
      this.event(vehicle.id, `continues to step ${step}`);
    }
    if (vehicle.reached !== step && Math.abs(vehicle.distance - this.radius) < 20 && this.t_s > 20 && step === 0) {
      vehicle.reached = step;
      this.event(vehicle.id, `reached step ${step}`);
    }
  }

  age(receiver, sender) {
    if (!sender.isAlive) return 1000 * sender.silent_s + 40;
    if (this.blocked(receiver.id, sender.id)) return 1000 * (this.t_s - this.cut_s) + 60;
    return 30 + (((this.t_s * 1000 + 137 * receiver.number + 71 * sender.number * (1 + receiver.number)) | 0) % 190);
  }

  row(vehicle, others) {
    const peers = others.filter((one) => one !== vehicle && one.team === vehicle.team).map((one) => {
      const age = this.age(vehicle, one);
      return [one.id, Math.round(age), age > 2000 ? "lost" : age > 500 ? "stale" : "fresh"];
    });
    let [nearest, nearest_m] = [null, null];
    for (const other of others) {
      if (other === vehicle) continue;
      const distance = Math.hypot(other.ne[0] + other.place[0] - vehicle.ne[0] - vehicle.place[0], other.ne[1] + other.place[1] - vehicle.ne[1] - vehicle.place[1]);
      if (nearest_m === null || distance < nearest_m) [nearest, nearest_m] = [other.id, distance];
    }
    return {
      id: vehicle.id, contact: vehicle.isAlive, silent_s: vehicle.isAlive ? 0.05 : vehicle.silent_s,
      phase: this.t_s < 14 ? "taking off" : "formation", in_place_s: this.t_s < 14 ? null : this.t_s - 14, membership: "active", step: vehicle.step, reached: vehicle.reached,
      live: peers.filter(([, , status]) => status !== "lost").length + 1,
      ne_m: [0, 1].map((axis) => vehicle.ne[axis] + vehicle.place[axis]), altitude_m: vehicle.altitude,
      velocity_ned_m_s: [...vehicle.v, 0], attitude_rad: [0.02, -0.03, vehicle.heading],
      centre_ne_m: vehicle.centre ? [0, 1].map((axis) => vehicle.centre[axis] + vehicle.place[axis]) : null,
      distance_m: vehicle.distance, gap_deg: vehicle.gap, gap_error_deg: vehicle.gap_error, nearest_m, nearest,
      setpoint_altitude_m: 30, field_ne: vehicle.v.map((v) => v / 5), error_ne_m: vehicle.v, controls: [0.01, -0.02, 0.03, 0.55], energy_left: 0.62,
      frame_rate_hz: 50, jitter_ms: 0.1 + 0.3 * vehicle.jitter, step_p99_us: Math.round(20 + 15 * vehicle.jitter), overruns: 0, refused: 0,
      failures: vehicle.failures, order: null, peers,
    };
  }

  snapshot(detail, field) {
    const isLarge = this.vehicles.length > 100;
    const shown = isLarge ? this.vehicles.filter(({ id }) => detail.includes(id)) : this.vehicles;
    const silent = this.vehicles.filter(({ isAlive }) => !isAlive);
    const all = this.vehicles.length;
    return {
      type: "snapshot", t_s: this.t_s, at_ms: Date.now(),
      status: {
        level: silent.length ? "bad" : "ok",
        text: `${all - silent.length}/${all} in formation · step ${this.vehicles[0].step} of 4 · worst gap 3.1° · nearest 22 m`,
        reasons: silent.map(({ id, silent_s }) => `vehicle ${id}: lost ${silent_s.toFixed(0)} s ago`),
      },
      vehicles: shown.map((vehicle) => this.row(vehicle, shown)),
      ...(field ? { field: this.field(field) } : {}),
    };
  }

  /** A field that points onto the ring. */
  field(id) {
    const own = this.vehicles.find((one) => one.id === id);
    if (!own?.centre) return null;
    const line = Array.from({ length: 21 }, (_, at) => (at - 10) * this.radius * 0.16);
    const ne = line.flatMap((north) => line.map((east) => {
      const distance = Math.hypot(north, east) || 1;
      const pull = Math.tanh((this.radius - distance) / 40);
      return [(north / distance) * pull, (east / distance) * pull];
    }));
    return { vehicle: id, north_m: line.map((v) => v + own.centre[0]), east_m: line.map((v) => v + own.centre[1]), ne };
  }

  crowd() {
    const size = this.vehicles.length;
    const buffer = new ArrayBuffer(16 + 17 * size);
    const view = new DataView(buffer);
    view.setUint32(0, 0x4e454b53, true);
    view.setUint32(4, size, true);
    view.setFloat64(8, this.t_s, true);
    this.vehicles.forEach(({ ne, place, altitude, heading, isAlive, failures, distance }, at) => {
      const put = (array, value) => view.setFloat32(16 + 4 * (size * array + at), value, true);
      put(0, ne[0] + place[0]);
      put(1, ne[1] + place[1]);
      put(2, altitude);
      put(3, heading);
      const isAtPlace = Math.abs((distance ?? 0) - this.radius) < 20;
      view.setUint8(16 + 16 * size + at, (isAlive ? 1 : 0) | 2 | (isAtPlace ? 4 : 0) | (failures.length ? 8 : 0));
    });
    return buffer;
  }
}

/** Serves the page and a swarm; `kill`, `cut` and `stop` act on them. With a `refusal`, `[status, text]`, no WebSocket is accepted. */
export async function serve({ port = 0, source = "live", hz = 10, orders = false, problem = null, refusal = null, ...of } = {}) {
  const swarm = new MockSwarm(of);
  const server = createServer((request, response) => {
    const path = new URL(request.url, "http://mock").pathname;
    if (path === "/live" && request.method === "POST") return response.writeHead(refusal?.[0] ?? 204).end(refusal?.[1]);
    const file = join(PAGE, normalize(path === "/" ? "/index.html" : path));
    if (!file.startsWith(PAGE) || !existsSync(file)) return response.writeHead(404).end();
    response.writeHead(200, {
      "content-type": TYPES[extname(file)] ?? "text/plain", "content-security-policy": CSP, "cache-control": "no-store",
    });
    return createReadStream(file).pipe(response);
  });
  const verifyClient = (_info, done) => (refusal ? done(false, refusal[0] === 204 ? 502 : refusal[0]) : done(true));
  const sockets = new WebSocketServer({ server, path: "/live", maxPayload: 4096, verifyClient });
  let play = { speed: source === "live" ? 1 : 0, isOnce: false };
  const received = [];
  sockets.on("connection", (socket) => {
    socket.detail = [];
    socket.send(JSON.stringify(swarm.hello(source, { orders })));
    socket.send(JSON.stringify({ type: "events", events: swarm.events }));
    if (problem) socket.send(JSON.stringify({ type: "problem", ...problem }));
    socket.on("message", (data) => {
      const message = JSON.parse(data);
      received.push(message);
      if (message.type === "detail") socket.detail = message.vehicles;
      if (message.type === "field") socket.field = message.vehicle;
      if (message.type === "order") socket.send(JSON.stringify({ type: "ordered", text: "taken by 7 of 8; 3 does not answer", ok: false }));
      if (message.type === "play") {
        play = { speed: message.speed, isOnce: true };
        // A synthetic recording can only be played forward: a jump is a jump of its clock.
        swarm.t_s = message.at_s;
      }
    });
  });
  const period_s = 1 / hz;
  let isQuiet = false;
  const send = (isJump) => {
    if (problem || isQuiet) return;
    const before = swarm.events.length;
    if (!isJump && play.speed > 0) swarm.advance(period_s * play.speed);
    else if (!play.isOnce) return;
    play.isOnce = false;
    const crowd = swarm.vehicles.length > 100 ? swarm.crowd() : null;
    for (const socket of sockets.clients) {
      for (const event of swarm.events.slice(before)) socket.send(JSON.stringify(event));
      if (crowd) socket.send(crowd);
      socket.send(JSON.stringify(swarm.snapshot(socket.detail, socket.field)));
    }
  };
  const timer = setInterval(send, 1000 * period_s);
  await new Promise((ready) => server.listen(port, "127.0.0.1", ready));
  return {
    swarm, received,
    url: `http://127.0.0.1:${server.address().port}/`,
    port: server.address().port,
    /** Sends these bytes to every page. */
    broadcast(data) {
      for (const socket of sockets.clients) socket.send(data);
    },
    /** Sends nothing to any page until `isQuiet` is false again; the swarm stands still. */
    quiet(isSo) {
      isQuiet = isSo;
    },
    /** Lets the swarm fly for so long at once. */
    skip(seconds) {
      for (let at = 0; at < seconds; at += 0.5) swarm.advance(0.5);
    },
    async stop() {
      clearInterval(timer);
      for (const socket of sockets.clients) socket.terminate();
      await new Promise((closed) => server.close(closed));
    },
  };
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const value = (name, otherwise) => {
    const at = process.argv.indexOf(`--${name}`);
    return at < 0 ? otherwise : process.argv[at + 1];
  };
  const mock = await serve({
    port: Number(value("port", 7480)), vehicles: Number(value("vehicles", 4)), teams: Number(value("teams", 1)),
    source: value("source", "live"), gamma: Number(value("gamma", 1)),
  });
  process.stdout.write(`${mock.url}\n`);
}
