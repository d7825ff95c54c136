// A headless Chromium with the page of `skein view` in it, and what tests read from it.

import assert from "node:assert/strict";
import { setTimeout as sleep } from "node:timers/promises";
import { chromium } from "playwright-core";

const CHROMIUM = process.env.SKEIN_CHROMIUM ?? "/usr/bin/chromium";
const FLAGS = [
  "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync",
];

/** Whether times are measured and must keep their limits: on a PC that does nothing else. */
export const MEASURES = process.env.SKEIN_PAGE_TIMES === "required";

/** Starts Chromium, with a profile of its own. */
export const startBrowser = () => chromium.launch({ executablePath: CHROMIUM, args: FLAGS });

/** The page at an address. `faults` collects errors of the console and requests to other hosts. */
export async function open(browser, url, { size, theme } = {}) {
  const page = await browser.newPage({ viewport: size ?? { width: 1440, height: 900 }, colorScheme: theme ?? "dark" });
  const faults = [];
  page.on("console", (message) => {
    // Chromium reports every failed attempt to reconnect.
    const isRefused = /ERR_CONNECTION_REFUSED|WebSocket connection .* failed/.test(message.text());
    if (message.type() === "error" && !isRefused) faults.push(message.text());
  });
  page.on("pageerror", (error) => faults.push(error.stack ?? String(error)));
  page.on("request", (request) => {
    if (new URL(request.url()).host !== new URL(url).host) faults.push(`request to ${request.url()}`);
  });
  await page.goto(url);
  return { page, faults };
}

/** How long a test waits for what must come, s: long, because the PC may be busy. */
const PATIENCE_S = 60;

/** Waits until `check()` returns something true; returns it with the time it took, s. */
export async function until(what, check, patience_s = PATIENCE_S) {
  const begun = performance.now();
  for (;;) {
    const found = await check();
    const took_s = (performance.now() - begun) / 1000;
    if (found) return { found, took_s };
    if (took_s > patience_s) throw new Error(`${what}: not within ${patience_s} s`);
    await sleep(30);
  }
}

export const textOf = (page, selector) => page.locator(selector).textContent();

/** The row of a vehicle in the table. */
export const rowOf = (page, id) => page.locator(`#table tr[data-vehicle="${id}"]`);

/** Selects a vehicle and reads its position from the card, m north and east. */
export async function readPosition(page, id) {
  await page.keyboard.press("Escape");
  await rowOf(page, id).click();
  await until(`card of vehicle ${id}`, async () => (await textOf(page, "#detail h2")).startsWith(`Vehicle ${id}:`));
  const text = (await textOf(page, "#detail .position")).replaceAll("−", "-");
  const [, north, east] = /N (-?[\d.]+)\s+E (-?[\d.]+)/.exec(text);
  return [Number(north), Number(east)];
}

/** Moves a vehicle to the middle of the map, points the mouse there, and reads where the map says that is. */
export async function readMap(page, id) {
  await page.keyboard.press("Escape");
  await rowOf(page, id).click();
  for (let at = 0; at < 8; at += 1) await page.keyboard.press("+");
  const box = await page.locator("#map").boundingBox();
  // On a busy PC the map may not be drawn anew yet.
  await until(`vehicle ${id} in the middle of the map`, async () => {
    await page.keyboard.press("c");
    await page.mouse.move(box.x + box.width / 2 - 1, box.y + box.height / 2);
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    return (await textOf(page, "#tip")).startsWith(`vehicle ${id} `);
  });
  const text = (await textOf(page, "#cursor")).replaceAll("−", "-");
  const [, north, east] = /N (-?[\d.]+)\s+E (-?[\d.]+)/.exec(text);
  return [Number(north), Number(east)];
}

/** Number of pixels of a canvas near a colour of the style sheet. */
export const pixelsOf = (page, canvas, colour) => page.evaluate(([selector, name]) => {
  const shown = document.querySelector(selector);
  const probe = document.createElement("canvas").getContext("2d");
  probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  probe.fillRect(0, 0, 1, 1);
  const wanted = probe.getImageData(0, 0, 1, 1).data;
  const { data } = shown.getContext("2d").getImageData(0, 0, shown.width, shown.height);
  let found = 0;
  for (let at = 0; at < data.length; at += 4) {
    const isNear = [0, 1, 2].every((part) => Math.abs(data[at + part] - wanted[part]) < 24);
    if (isNear && data[at + 3] > 100) found += 1;
  }
  return found;
}, [canvas, colour]);

/**
 * What a frame costs the main thread, from script to paint: mean processor time, ms, the time below which 95 of 100 frames
 * are, and their number. `busy` is the share of the main thread that the page takes altogether. Where the limit is to be kept,
 * the PC may still be busy with other things: the best of three spells counts.
 */
async function frameTime(browser, page) {
  const [spells, seconds] = MEASURES ? [3, 3] : [1, 1];
  const found = [];
  for (let at = 0; at < spells; at += 1) {
    await browser.startTracing(page, { categories: ["devtools.timeline", "toplevel", "cc"] });
    await sleep(1000 * seconds);
    const { traceEvents } = JSON.parse((await browser.stopTracing()).toString());
    found.push(readTrace(traceEvents, seconds));
  }
  return found.sort((one, two) => one.ms - two.ms)[0];
}

/** Prints what a frame costs; where figures are measured, it must be below a limit, ms. */
export async function checkFrameTime(browser, page, name, limit_ms) {
  const cost = await frameTime(browser, page);
  console.log(`${name}: ${frameText(cost)}`);
  assert.ok(cost.frames > 0, "the page draws");
  if (MEASURES) assert.ok(cost.ms < limit_ms, `${name}: ${frameText(cost)}`);
}

function readTrace(events, seconds) {
  const drawn = events.find(({ name }) => name === "FireAnimationFrame");
  const own = events.filter(({ pid, tid, ph }) => drawn && pid === drawn.pid && tid === drawn.tid && ph === "X");
  const cpu_ms = (name) => own.filter((event) => event.name === name).map(({ tdur }) => (tdur ?? 0) / 1000);
  const sum = (list) => list.reduce((total, value) => total + value, 0);
  const frames = cpu_ms("ProxyMain::BeginMainFrame").sort((one, two) => one - two);
  return {
    frames: frames.length,
    ms: sum(frames) / frames.length,
    p95_ms: frames[Math.floor(0.95 * frames.length)],
    busy: sum(cpu_ms("ThreadControllerImpl::RunTask")) / 1000 / seconds,
  };
}

/** The figures of `frameTime` as text. */
const frameText = ({ frames, ms, p95_ms, busy }) => `${ms.toFixed(2)} ms of the main thread a frame, 95 of 100 below `
  + `${p95_ms.toFixed(2)} ms; ${frames} frames, ${(100 * busy).toFixed(0)} % of the main thread`;
