// Foxglove's server against an independent client: a live flight and its recording, every channel received and decoded.

import assert from "node:assert/strict";
import { readdir } from "node:fs/promises";
import { join } from "node:path";
import { after, before, test } from "node:test";
import protocol from "@foxglove/ws-protocol";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";
import WebSocket from "ws";
import { until } from "./browser.mjs";
import { Place } from "./flight.mjs";

const SCENARIO = `
name = "foxglove"
duration_s = 600
[swarm]
name = "foxglove"
vehicles = 2
[start]
square_m = 60
[formation]
radius_m = 60
altitude_m = 5
[mission]
# Something happens again and again: on a busy PC the client may subscribe after everything else has happened.
events = [${Array.from({ length: 40 }, (_, nth) => `{ at_s = ${3 + 3 * nth}, order = "hold", for_s = 1 }`).join(", ")}]
`;
const { FoxgloveClient } = protocol;
const PLAYBACK_STATE = 5;
const PLAY = 0;
const PAUSE = 1;
const ENDED = 3;

let place;

before(async () => {
  place = await Place.make();
});
after(async () => {
  await place?.remove();
});

/** How the messages of this channel are decoded, by the schema that the server has advertised. */
function decoder(channel) {
  if (channel.encoding === "json") {
    const schema = JSON.parse(channel.schema);
    return (bytes) => {
      const message = JSON.parse(new TextDecoder().decode(bytes));
      for (const key of schema.required ?? []) assert.ok(key in message, `${channel.topic} lacks ${key}`);
      for (const key of Object.keys(message)) {
        assert.ok(key in schema.properties || schema.description.includes(`\`${key}\``), `${channel.topic}: ${key} is not in the schema`);
      }
      return message;
    };
  }
  assert.equal(channel.encoding, "protobuf");
  const set = descriptor.FileDescriptorSet.decode(Buffer.from(channel.schema, "base64"));
  const type = protobuf.Root.fromDescriptor(set).lookupType(channel.schemaName);
  return (bytes) => type.toObject(type.decode(bytes), { longs: Number });
}

/** A client that subscribes to every channel and keeps the messages of each topic. */
class Reader {
  constructor(url) {
    this.socket = new WebSocket(url, ["foxglove.sdk.v1"]);
    this.client = new FoxgloveClient({ ws: this.socket });
    this.channels = new Map();
    this.messages = new Map();
    this.parameters = [];
    this.states = [];
    this.times = 0;
    const bySubscription = new Map();
    this.client.on("serverInfo", (info) => (this.info = info));
    const subscribe = (channel) => bySubscription.set(this.client.subscribe(channel.id), { channel, decode: decoder(channel) });
    this.client.on("advertise", (channels) => {
      for (const channel of channels) {
        this.channels.set(channel.topic, channel);
        subscribe(channel);
      }
    });
    this.client.on("message", ({ subscriptionId, timestamp, data }) => {
      const { channel, decode } = bySubscription.get(subscriptionId);
      const kept = this.messages.get(channel.topic) ?? [];
      kept.push({ atNs: timestamp, message: decode(new Uint8Array(data.buffer, data.byteOffset, data.byteLength)) });
      this.messages.set(channel.topic, kept);
    });
    this.client.on("time", () => (this.times += 1));
    this.client.on("parameterValues", ({ parameters }) => (this.parameters = parameters));
    // The client's library is older than playback, which it calls an error; anything else is one.
    this.problems = [];
    this.client.on("error", (error) => {
      if (!/opcode/i.test(error.message)) this.problems.push(error.message);
    });
    this.client.on("status", (status) => {
      this.status = status;
      // The server of the crate advertises a channel before it knows that the client may subscribe to it, and refuses a
      // subscription that comes in between.
      const refused = /^Unknown channel ID: (\d+)$/.exec(status.message);
      const channel = refused && [...this.channels.values()].find((other) => String(other.id) === refused[1]);
      if (channel) subscribe(channel);
    });
    this.socket.addEventListener("message", ({ data }) => {
      if (typeof data === "string") return;
      const view = new DataView(data);
      if (view.getUint8(0) === PLAYBACK_STATE) {
        this.states.push({ status: view.getUint8(1), atNs: view.getBigUint64(2, true), speed: view.getFloat32(10, true) });
      }
    });
  }

  get topics() {
    return [...this.channels.keys()].sort();
  }

  count(topic) {
    return this.messages.get(topic)?.length ?? 0;
  }

  last(topic) {
    return this.messages.get(topic).at(-1);
  }

  control(command, speed, seekNs) {
    const id = new TextEncoder().encode("test");
    const view = new DataView(new ArrayBuffer(1 + 18 + id.length));
    view.setUint8(0, 3);
    view.setUint8(1, command);
    view.setFloat32(2, speed, true);
    view.setUint8(6, seekNs === undefined ? 0 : 1);
    view.setBigUint64(7, seekNs ?? 0n, true);
    view.setUint32(15, id.length, true);
    new Uint8Array(view.buffer).set(id, 19);
    this.socket.send(view.buffer);
  }

  close() {
    this.client.close();
  }
}

/** The address of the server for Foxglove, which `skein view` prints after that of the page. */
async function foxgloveOf(view) {
  const { found } = await until("address for Foxglove", async () => view.lines.find((line) => line.startsWith("ws://")));
  return found;
}

test("every channel of a live flight is received and decoded", async () => {
  const view = await place.view("--listen", "127.0.0.1:0", "--foxglove", "127.0.0.1:0");
  const reader = new Reader(await foxgloveOf(view));
  await until("reason why nothing is shown", async () => /no swarm/.test(reader.status?.message));
  await place.fly(SCENARIO);
  // Faults are known to the program that injects them only: they are in its recording.
  const silent = ["/faults"];
  const without = () => reader.topics.filter((topic) => !silent.includes(topic) && reader.count(topic) === 0);
  await until("a message on every channel", async () => reader.channels.size === 10 && without().length === 0).catch((error) => {
    throw new Error(`${error.message}; of ${reader.channels.size} channels none on ${without().join(", ")}`);
  });
  const vehicle = (id) => [`/vehicle/${id}/location`, `/vehicle/${id}/trace`];
  const topics = ["/events", "/faults", "/log", "/scene/formation", "/scene/vehicles", "/tf", ...vehicle(1), ...vehicle(2)];
  assert.deepEqual(reader.topics, topics);

  // One and the same place in all of them: degrees, metres east and north, and the trace's own north and east.
  const { atNs, message: trace } = reader.last("/vehicle/1/trace");
  const { message: location } = reader.messages.get("/vehicle/1/location").find((other) => other.atNs === atNs) ?? reader.last("/vehicle/1/location");
  const transforms = reader.messages.get("/tf").filter((other) => other.message.transforms[0].childFrameId === "vehicle/1");
  const { message: transform } = transforms.find((other) => other.atNs === atNs) ?? transforms.at(-1);
  const { x: east, y: north, z: up } = transform.transforms[0].translation;
  assert.ok(Math.hypot(north - trace.position[0], east - trace.position[1], up + trace.position[2]) < 5, "tf and trace differ");
  assert.ok(Math.abs(location.latitude) > 0.01 && Math.abs(location.altitude) < 10_000, JSON.stringify(location));
  assert.equal(reader.last("/scene/vehicles").message.entities.length, 2);

  reader.client.getParameters([], "all");
  await until("parameters", async () => reader.parameters.length > 50);
  const parameter = (name) => reader.parameters.find((other) => other.name === name)?.value;
  assert.equal(parameter("formation.radius_m"), 60);
  reader.client.setParameters([{ name: "formation.radius_m", value: 10 }], "set");
  await until("warning", async () => /not changed/.test(reader.status?.message));
  await until("the value as it was", async () => reader.parameters.length === 1 && parameter("formation.radius_m") === 60);

  // A client that comes later is shown what was drawn before.
  const later = new Reader(reader.socket.url);
  await until("drawings", async () => later.count("/scene/vehicles") > 0 && later.count("/scene/formation") > 0);
  assert.deepEqual([reader.problems, later.problems], [[], []]);
  for (const one of [reader, later]) one.close();
});

test("a recording is played with pause and seek, every channel received and decoded", async () => {
  const out = join(place.folder, "study");
  const sets = ["swarm.vehicles=2", "duration_s=20", "record.runs=all", "mission.events=[{ at_s = 10, fault = 'kill', vehicle = 2 }]"];
  const study = place.start("study", "--seed", "1", "--out", out, ...sets.flatMap((set) => ["--set", set]));
  assert.equal(await study.ended, 0, study.errors.join("\n"));
  const files = await readdir(out, { recursive: true });
  const recording = join(out, files.find((file) => file.endsWith("run.mcap")));
  const view = await place.view(recording, "--listen", "127.0.0.1:0", "--foxglove", "127.0.0.1:0");
  const reader = new Reader(await foxgloveOf(view));
  await until("channels", async () => reader.channels.size === 10);
  reader.control(PLAY, 16);
  await until("end of the recording", async () => reader.states.some((state) => state.status === ENDED));
  await until("a message on every channel", async () => reader.topics.every((topic) => reader.count(topic) > 0));
  assert.ok(reader.info.capabilities.includes("playbackControl"), JSON.stringify(reader.info));
  assert.ok(reader.times > 0);
  // Ten steps a second of vehicle 1; vehicle 2 was killed halfway. What shows the first instant may come twice.
  assert.ok(Math.abs(reader.count("/vehicle/1/trace") - 200) < 15, `${reader.count("/vehicle/1/trace")}`);
  assert.ok(Math.abs(reader.count("/vehicle/2/trace") - 100) < 15, `${reader.count("/vehicle/2/trace")}`);

  const before = reader.count("/vehicle/1/trace");
  reader.control(PAUSE, 1, 5_000_000_000n);
  await until("the steps just before 5 s", async () => reader.count("/vehicle/1/trace") > before);
  const shown = reader.last("/vehicle/1/trace").atNs;
  assert.ok(shown > 4_800_000_000n && shown <= 5_000_000_000n, `${shown}`);
  assert.deepEqual(reader.problems, []);
  reader.close();
});
