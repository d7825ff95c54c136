// The parts of the page that need no browser: numbers as text, who receives whom, the memory of the last minutes.

import assert from "node:assert/strict";
import { test } from "node:test";
import { liveAddress, readCrowd, reasonOf } from "../../deploy/view/src/page/connection.js";
import * as format from "../../deploy/view/src/page/format.js";
import { Frame } from "../../deploy/view/src/page/frame.js";
import { History } from "../../deploy/view/src/page/history.js";
import { Player } from "../../deploy/view/src/page/player.js";
import { analyse, describe } from "../../deploy/view/src/page/reception.js";
import { Swarm } from "../../deploy/view/src/page/swarm.js";
import { MockSwarm } from "./mock.mjs";

/** A swarm of so many vehicles, as the page has it, with a picture in which `act` changed something. */
function picture(vehicles, act, teams = 1) {
  const mock = new MockSwarm({ vehicles, teams });
  mock.advance(1);
  act?.(mock);
  mock.advance(3);
  const swarm = new Swarm(mock.hello("live"));
  const frame = new Frame(swarm, mock.snapshot([], null));
  const found = analyse(frame);
  return { frame, swarm, found, text: describe(found, frame, swarm) };
}

test("numbers, ages, times and ids are written as people read them", () => {
  assert.deepEqual([-0.04, 3.25, null, NaN, -12].map((value) => format.number(value, 1)), ["0.0", "3.3", "–", "–", "−12.0"]);
  assert.deepEqual([0.3, -0.3, 0].map((value) => format.signed(value, 1)), ["+0.3", "−0.3", "0.0"]);
  assert.deepEqual([80, 2400, 14_000, 300_000, null].map(format.age), ["80 ms", "2.4 s", "14 s", "5 min", "–"]);
  assert.deepEqual([0, 133, 3733, -5].map((value) => format.time(value)), ["00:00", "02:13", "1:02:13", "−00:05"]);
  assert.equal(format.time(61.27, true), "01:01.2");
  assert.equal(format.ids(["1", "2", "3", "5", "7", "8", "2/1"]), "1–3, 5, 7, 8, 2/1");
  assert.equal(format.ids(["1", "3", "5"], 2), "1, 3, …");
  assert.deepEqual([0.13, 1, 47, 900].map((span) => format.tickStep(span, 5)), [0.05, 0.2, 10, 200]);
});

test("partitions, cuts and one-way links are found and named", () => {
  assert.match(picture(4).text.text, /^all receive all · oldest message \d+ ms, from \d at \d$/);
  const cut = picture(6, (mock) => mock.cut(["1", "2", "5"]));
  assert.deepEqual([cut.text.level, cut.text.text], ["bad", "2 partitions: 1, 2, 5 | 3, 4, 6"]);
  assert.equal(cut.found.lost, 18);
  const oneWay = picture(3, (mock) => mock.cut(["3"], false));
  assert.deepEqual(oneWay.found.oneWay, [[0, 2], [1, 2]]);
  assert.equal(oneWay.text.text, "one way: 1 receives 3, not the reverse, and 1 more");
  const silent = picture(3, (mock) => mock.kill("2"));
  assert.deepEqual(silent.found.silent, [1]);
  assert.match(silent.text.text, /^the others receive each other .* · no contact with 2$/);
});

test("the teams of a fleet are no partitions; those within a team are", () => {
  const whole = picture(16, null, 4);
  assert.deepEqual([whole.found.partitions.length, whole.found.divided, whole.text.level], [4, [], "ok"]);
  assert.match(whole.text.text, /^all receive all of their team · oldest message/);
  const cut = picture(12, (mock) => mock.cut(["2/1", "3/4"]), 3);
  assert.deepEqual([cut.text.level, cut.text.text], [
    "bad", "team 2: 2 partitions: 2/1 | 2/2, 2/3, 2/4; team 3: 2 partitions: 3/1, 3/2, 3/3 | 3/4",
  ]);
  const ids = cut.found.divided.map((rows) => rows.map((row) => cut.swarm.ids[cut.frame.members[row]]).join());
  assert.deepEqual(ids.sort(), ["2/1", "2/2,2/3,2/4", "3/1,3/2,3/3", "3/4"]);
  const silent = picture(4, (mock) => mock.kill("2/1"), 2);
  assert.match(silent.text.text, /no contact with 2\/1$/);
  assert.deepEqual(silent.found.divided, []);
});

test("the memory of ten minutes of fifty vehicles is thinned out and bounded", () => {
  const mock = new MockSwarm({ vehicles: 50 });
  const swarm = new Swarm(mock.hello("live"));
  const history = new History(swarm);
  const snapshot = JSON.stringify(mock.snapshot([], null));
  for (let at = 0; at < 6500; at += 1) history.add({ ...JSON.parse(snapshot), at_ms: 1e12 + 100 * at });
  const [first, last] = [history.frames[0].key, history.newest.key];
  assert.ok(last - first > 598 && last - first <= 601, `${last - first} s`);
  assert.ok(history.frames.length < 1500, `${history.frames.length} pictures`);
  const bytes = history.frames.reduce((sum, frame) => sum + frame.bytes, 0);
  assert.ok(bytes < 100e6, `${(bytes / 1e6).toFixed(0)} MB`);
  // A picture of the past has the same rows as when it was new.
  const past = history.at(last - 300);
  assert.ok(Math.abs(past.key - (last - 300)) < 0.6);
  assert.equal(past.rows.length, 50);
  assert.equal(past.vehicle(7).id, "8");
});

test("a player shows the past, catches up with the present and never leaves what it has", () => {
  const mock = new MockSwarm({ vehicles: 2 });
  const swarm = new Swarm(mock.hello("live"));
  const history = new History(swarm);
  const player = new Player(swarm, history, () => assert.fail("a live flight asks nothing of the server"));
  for (let at = 0; at <= 300; at += 1) history.add({ ...mock.snapshot([], null), at_ms: 100 * at });
  player.seek(-50);
  assert.ok(player.frame.isUnknown, "the page was not open then");
  player.toBegin();
  assert.equal(player.frame.key, 0);
  assert.equal(player.frame.isUnknown, false);
  player.seek(12.34);
  assert.equal(player.frame.key, 12.3);
  player.changeSpeed(3);
  assert.ok(player.tick(2) && Math.abs(player.position - 28.34) < 1e-9);
  player.tick(0.25);
  assert.equal(player.isLookingBack, false);
  assert.equal(player.frame, history.newest);
});

test("binary positions are read only if their size agrees", () => {
  const mock = new MockSwarm({ vehicles: 120 });
  const crowd = readCrowd(mock.crowd());
  assert.equal(crowd.north.length, 120);
  assert.ok(Math.abs(crowd.north[17] - mock.vehicles[17].ne[0]) < 1e-4);
  assert.equal(readCrowd(mock.crowd().slice(0, -1)), null);
  assert.equal(readCrowd(new ArrayBuffer(7)), null);
  assert.equal(readCrowd(new ArrayBuffer(16 + 17)), null);
});

test("a time of which nothing was received is unknown, before the first picture and between two", () => {
  const mock = new MockSwarm({ vehicles: 3 });
  mock.advance(1);
  const swarm = new Swarm(mock.hello("live"));
  const history = new History(swarm);
  const player = new Player(swarm, history, () => {});
  assert.equal(player.frame, null, "before the first picture");
  const receive = (from, to) => {
    for (let at = 10 * from; at <= 10 * to; at += 1) history.add({ ...mock.snapshot([], null), t_s: at / 10 - 90, at_ms: 100 * at });
  };
  receive(100, 110);
  receive(175, 180);
  const shown = (key) => {
    player.seek(key);
    return player.frame;
  };
  for (const key of [120.001, 135, 113, 174.9]) {
    const frame = shown(key);
    assert.ok(frame.isUnknown && player.frame === frame, `${key} s`);
    assert.deepEqual([frame.status.level, frame.status.reasons], ["none", []]);
    assert.match(frame.status.text, /^unknown/);
    assert.deepEqual(describe(analyse(frame), frame, swarm), { level: "none", text: "unknown" });
    assert.deepEqual(frame.rows.map(({ id, phase, contact }) => [id, phase, contact]), [1, 2, 3].map((id) => [`${id}`, "unknown", undefined]));
    assert.ok(Math.abs(frame.t_s - (key - 90)) < 1e-6);
  }
  for (const [key, found] of [[109.96, 109.9], [110, 110], [111.5, 110], [175, 175], [178.06, 178]]) {
    assert.ok(!shown(key).isUnknown && Math.abs(player.frame.key - found) < 0.6, `${key} s: ${player.frame.key}`);
  }
  assert.deepEqual(history.gaps, [[110, 175]]);
  assert.ok(history.isBroken(109, 176) && !history.isBroken(100, 110) && !history.isBroken(175, 180));
});

test("a page that reads a large fleet knows nothing of its teams at an unknown time", () => {
  const mock = new MockSwarm({ vehicles: 200, teams: 4 });
  const swarm = new Swarm(mock.hello("live"));
  const frame = Frame.unknown(swarm, 12, null);
  assert.deepEqual([frame.members.length, frame.isInContact(7), frame.hasPosition(7), frame.t_s], [0, false, false, null]);
});

test("the WebSocket is beside the page, wherever a proxy serves it", () => {
  const addresses = [
    ["http://127.0.0.1:7480/", "ws://127.0.0.1:7480/live"],
    ["https://swarm.example.com/", "wss://swarm.example.com/live"],
    ["https://example.com/lab/swarm/", "wss://example.com/lab/swarm/live"],
    ["https://example.com:8443/swarm/index.html?x=1#y", "wss://example.com:8443/swarm/live"],
  ];
  for (const [page, live] of addresses) assert.equal(liveAddress(page), live);
});

test("a refusal is named with its remedy", () => {
  const why = "a page of a.example may not read this server: start it with --name a.example";
  assert.deepEqual(reasonOf(403, `${why}\n`), { text: "skein view refuses this page.", remedy: why });
  assert.equal(reasonOf(421, why).remedy, why);
  assert.match(reasonOf(204, "").remedy, /proxy .* Upgrade and Connection/);
  for (const status of [200, 404, 405, 500, 502]) assert.equal(reasonOf(status, "x"), null);
});
