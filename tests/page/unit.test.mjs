// The parts of the page that need no browser: numbers as text, who receives whom, the memory of the last minutes.

import assert from "node:assert/strict";
import { test } from "node:test";
import { readCrowd } from "../../deploy/src/view/page/connection.js";
import * as format from "../../deploy/src/view/page/format.js";
import { Frame } from "../../deploy/src/view/page/frame.js";
import { History } from "../../deploy/src/view/page/history.js";
import { Player } from "../../deploy/src/view/page/player.js";
import { analyse, describe } from "../../deploy/src/view/page/reception.js";
import { Swarm } from "../../deploy/src/view/page/swarm.js";
import { MockSwarm } from "./mock.mjs";

/** A swarm of so many vehicles, as the page has it, with a picture in which `act` changed something. */
function picture(vehicles, act) {
  const mock = new MockSwarm({ vehicles });
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
  assert.equal(player.frame.key, 0);
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
