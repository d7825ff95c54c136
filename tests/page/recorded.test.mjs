// What a frame of the page costs the main thread while it plays recordings of flights in virtual time. The large fleets are flown
// only where times are measured: that takes minutes.

import assert from "node:assert/strict";
import { writeFile } from "node:fs/promises";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { MEASURES, checkFrameTime, open, startBrowser, textOf, until } from "./browser.mjs";
import { Place } from "./flight.mjs";

/** Vehicles of a team of a fleet. */
const TEAM = 16;

let browser;
let place;
before(async () => {
  browser = await startBrowser();
  place = await Place.make();
});
after(async () => {
  await browser?.close();
  await place?.remove();
});

/** Flies in virtual time and returns the recording. */
async function record(name, scenario, file, ...args) {
  const written = join(place.folder, `${name}.toml`);
  await writeFile(written, scenario);
  const study = place.start("study", written, "--seed", "1", "--out", join(place.folder, name), ...args);
  assert.equal(await study.ended, 0, study.errors.join("\n"));
  return join(place.folder, name, file);
}

const swarm = (vehicles, duration_s) => record(
  `swarm-${vehicles}`,
  `duration_s = ${duration_s}\n[swarm]\nvehicles = ${vehicles}\n[start]\nsquare_m = ${30 * Math.ceil(Math.sqrt(vehicles))}\n`
    + `[formation]\nradius_m = ${12 * vehicles}\naltitude_m = 30\n`,
  "run.mcap", "--set", "record.runs=all",
);

const fleet = (vehicles, duration_s) => record(
  `fleet-${vehicles}`,
  `duration_s = ${duration_s}\n[fleet]\nteams = ${vehicles / TEAM}\n[swarm]\nvehicles = ${TEAM}\n[formation]\nradius_m = 100\naltitude_m = 30\n`,
  "fleet.mcap",
);

/** Plays a recording on the page and measures a frame. */
async function measure(recording, vehicles, limit_ms) {
  const view = await place.view(recording, "--listen", "127.0.0.1:0");
  const { page, faults } = await open(browser, view.url);
  try {
    await until("number of vehicles", async () => (await textOf(page, "#status")).includes(String(vehicles)));
    await until("the recording plays", async () => (await textOf(page, "#time")) > "00:02");
    await checkFrameTime(browser, page, `${vehicles} vehicles from a recording`, limit_ms);
    assert.deepEqual(faults, []);
  } finally {
    await page.close();
    view.child.kill("SIGKILL");
  }
}

test("a frame of 50 recorded vehicles costs the main thread little", async () => {
  await measure(await swarm(50, MEASURES ? 60 : 10), 50, 8);
});

for (const vehicles of [1008, 10_000]) {
  test(`a frame of ${vehicles} recorded vehicles costs the main thread little`, { skip: !MEASURES && "flown where times are measured" }, async () => {
    await measure(await fleet(vehicles, 20), vehicles, 16);
  });
}
