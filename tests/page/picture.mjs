// Makes the picture of the page that README and book show, from a real flight: six helicopters on a tour, of which one has just lost
// its agent. SKEIN_PROGRAM=target/release/skein node tests/page/picture.mjs deploy/book/src/view.png

import { readFile } from "node:fs/promises";
import { open, rowOf, startBrowser, until } from "./browser.mjs";
import { Place } from "./flight.mjs";

/** How long the agent is already gone, s. */
const GONE_S = 6;

const out = process.argv[2];
if (!out) throw new Error("usage: node tests/page/picture.mjs OUT.png");
const tour = await readFile(new URL("../../deploy/scenarios/tour.toml", import.meta.url), "utf8");
const browser = await startBrowser();
const place = await Place.make();
try {
  await place.fly(tour);
  const view = await place.view("--swarm", "tour", "--listen", "127.0.0.1:0");
  const { page } = await open(browser, view.url, { size: { width: 1440, height: 810 } });
  await until("six in formation", async () => {
    const rows = await page.locator("#table tbody tr").allTextContents();
    return rows.length === 6 && rows.every((row) => row.includes("formation"));
  }, 180);
  await until("a silent vehicle", async () => {
    const row = rowOf(page, "3");
    return (await row.count()) > 0 && /silent/.test(await row.textContent());
  }, 180);
  await page.waitForTimeout(1000 * GONE_S);
  await page.screenshot({ path: out });
} finally {
  await browser.close();
  await place.remove();
}
