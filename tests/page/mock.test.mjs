// The page against synthetic swarms: what it shows of every situation that the protocol can describe.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { open, pixelsOf, readMap, readPosition, rowOf, startBrowser, textOf, until } from "./browser.mjs";
import { serve } from "./mock.mjs";

let browser;
before(async () => (browser = await startBrowser()));
after(() => browser?.close());

/** Runs `act` with a page that shows a synthetic swarm; the page must not have logged an error in the end. */
async function withSwarm(options, act) {
  const mock = await serve(options);
  if (options.skip_s) mock.skip(options.skip_s);
  const { page, faults } = await open(browser, mock.url, options);
  try {
    await until("picture", async () => (await page.locator("#table tbody tr").count()) > 0 || options.isEmpty);
    await act({ mock, page });
    assert.deepEqual(faults, []);
  } finally {
    await page.close();
    await mock.stop();
  }
}

test("four vehicles are where the server reports them, in the card and on the map", () => withSwarm({ skip_s: 200 }, async ({ mock, page }) => {
  for (const { id, ne } of mock.swarm.vehicles) {
    const near = ([north, east]) => Math.hypot(north - ne[0], east - ne[1]) < 1;
    assert.ok(near(await readPosition(page, id)), `card of vehicle ${id}`);
    const place = await readMap(page, id);
    assert.ok(near(place), `vehicle ${id} on the map at ${place}, reported at ${ne}`);
  }
  assert.match(await textOf(page, "#links-text"), /all receive all/);
  assert.equal(await textOf(page, "#detail .energy"), "62 % left");
}));

test("a lost vehicle becomes a ghost, its row stays and the reason is named", () => withSwarm({ skip_s: 60 }, async ({ mock, page }) => {
  mock.swarm.kill("3");
  await until("silent row", async () => /silent/.test(await rowOf(page, "3").textContent()));
  assert.match(await rowOf(page, "3").getAttribute("class"), /gone/);
  await until("reason", async () => /vehicle 3: lost/.test(await textOf(page, "#status-reasons")));
  assert.equal(await page.locator("#status").getAttribute("data-level"), "bad");
  assert.equal(await page.locator("#table tbody tr").count(), 4);
  await until("link text", async () => /no contact with 3/.test(await textOf(page, "#links-text")));
}));

test("a swarm cut in two is named with its partitions and shows in links and matrix", () => withSwarm({ skip_s: 60 }, async ({ mock, page }) => {
  assert.equal(await pixelsOf(page, "#matrix", "age-5"), 0);
  mock.swarm.cut(["1", "2"]);
  await until("partitions", async () => (await textOf(page, "#links-text")) === "2 partitions: 1, 2 | 3, 4");
  assert.ok((await pixelsOf(page, "#matrix", "age-5")) > 1000);
  assert.ok((await pixelsOf(page, "#map", "age-5")) > 50);
}));

test("the fence is on the map", () => withSwarm({ skip_s: 60 }, async ({ page }) => {
  const shown = () => pixelsOf(page, "#map", "bad");
  const close = await shown();
  for (let at = 0; at < 6; at += 1) await page.keyboard.press("-");
  await until("fence", async () => (await shown()) > close + 300);
}));

test("a link that works one way is named with its direction", () => withSwarm({ skip_s: 60 }, async ({ mock, page }) => {
  mock.swarm.cut(["1"], false);
  await until("one way", async () => /one way: 2 receives 1, not the reverse, and 2 more/.test(await textOf(page, "#links-text")));
}));

test("selecting a vehicle asks for its field, draws it and filters events and plots", () => withSwarm({ skip_s: 60 }, async ({ mock, page }) => {
  await until("events", async () => (await page.locator("#events li").count()) > 0);
  // Some edges of other lines have a similar colour.
  assert.ok((await pixelsOf(page, "#map", "field")) < 50);
  await rowOf(page, "2").click();
  await until("field", async () => (await pixelsOf(page, "#map", "field")) > 300);
  assert.deepEqual(mock.received.filter(({ type }) => type === "field").at(-1), { type: "field", vehicle: "2" });
  await until("plot", async () => (await textOf(page, "#plot-pairs-title")) === "Distances from vehicle 2, m");
  for (const subject of await page.locator("#events b").allTextContents()) assert.equal(subject, "vehicle 2");
  await page.keyboard.press("Escape");
  await until("closed", async () => !(await page.locator("#detail").isVisible()));
}));

test("the same event of several vehicles is one line, and markup in it stays text", () => withSwarm({ skip_s: 10 }, async ({ mock, page }) => {
  for (const { id } of mock.swarm.vehicles) mock.swarm.event(id, "<img src=x onerror=alert(1)> reached step 7", "warn");
  mock.swarm.events.splice(0, mock.swarm.events.length - 4);
  await page.reload();
  await until("event", async () => /reached step 7/.test(await textOf(page, "#events")));
  assert.match(await textOf(page, "#events li"), /4 vehicles <img src=x onerror=alert\(1\)> reached step 7/);
  assert.equal(await page.locator("#events img").count(), 0);
}));

test("the last minutes can be looked at again while the flight continues", () => withSwarm({ skip_s: 60 }, async ({ page }) => {
  await page.waitForTimeout(3000);
  await page.keyboard.press("ArrowLeft");
  await page.keyboard.press("ArrowLeft");
  const past = await until("past", async () => {
    // On a busy PC the second step back may be drawn after the first has been seen.
    const time = await textOf(page, "#time");
    await page.waitForTimeout(400);
    return /ago/.test(await textOf(page, "#now")) && (await textOf(page, "#time")) === time && time;
  });
  await page.waitForTimeout(800);
  assert.equal(await textOf(page, "#time"), past.found, "paused");
  await page.keyboard.press(" ");
  await until("playing", async () => (await textOf(page, "#time")) > past.found);
  await page.keyboard.press("End");
  await until("now", async () => (await textOf(page, "#now")) === "live");
}));

test("a recording plays, faster, and from another place", () => withSwarm({ source: "recording" }, async ({ mock, page }) => {
  const plays = () => mock.received.filter(({ type }) => type === "play");
  assert.deepEqual(plays()[0], { type: "play", at_s: 0, speed: 1 });
  await page.keyboard.press(".");
  await until("speed", async () => plays().at(-1).speed === 2);
  await page.keyboard.press(" ");
  await until("pause", async () => plays().at(-1).speed === 0);
  const box = await page.locator("#time-bar").boundingBox();
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  await until("seek", async () => Math.abs(plays().at(-1).at_s - 200) < 2);
  // The bar may have moved by some pixels between the two lines: what counts is that the place asked for is shown.
  const { at_s } = plays().at(-1);
  await until(`place ${at_s} s`, async () => {
    const [minutes, seconds] = (await textOf(page, "#time")).split(":").map(Number.parseFloat);
    return Math.abs(60 * minutes + seconds - at_s) <= 1;
  });
}));

test("the page reports a lost server, reconnects and keeps what it has seen", async () => {
  let mock = await serve({});
  mock.skip(60);
  const { page, faults } = await open(browser, mock.url);
  await until("picture", async () => (await page.locator("#table tbody tr").count()) === 4);
  await page.waitForTimeout(1500);
  const { port, swarm } = mock;
  await mock.stop();
  await until("banner", async () => /Connection to skein view lost/.test(await textOf(page, "#banner")));
  mock = await serve({ port });
  mock.swarm.t_s = swarm.t_s;
  await until("reconnection", async () => !(await page.locator("#banner").isVisible()));
  await until("picture again", async () => (await textOf(page, "#now")) === "live");
  await page.keyboard.press("Home");
  await until("past", async () => /ago/.test(await textOf(page, "#now")));
  assert.deepEqual(faults, []);
  await page.close();
  await mock.stop();
});

test("what keeps the server from showing a swarm is on the page with its remedy", () => withSwarm(
  { problem: { text: "No agent of swarm hover answers.", remedy: "Start it with skein fly." }, isEmpty: true },
  async ({ page }) => {
    await until("problem", async () => /No agent of swarm hover answers\..*Start it with skein fly\./.test(await textOf(page, "#banner")));
  },
));

test("messages of other kinds and broken ones change nothing", () => withSwarm({ skip_s: 30 }, async ({ mock, page }) => {
  for (const text of ["{", "null", "[]", "7", '{"type":"toString"}', '{"type":"snapshot"}', '{"type":"later"}']) mock.broadcast(text);
  mock.broadcast(Buffer.from("SKENxxxxxxxxxxxxxxxxxx"));
  const before = await textOf(page, "#time");
  await until("time", async () => (await textOf(page, "#time")) > before);
  assert.equal(await page.locator("#table tbody tr").count(), 4);
}));

test("orders need a confirmation and show what became of them", () => withSwarm({ vehicles: 8, orders: true, skip_s: 30 }, async ({ mock, page }) => {
  const orders = () => mock.received.filter(({ type }) => type === "order");
  await rowOf(page, "3").click();
  await page.keyboard.press("o");
  await page.locator("#orders input[value=land]").check();
  await page.locator("#orders button.main").click();
  assert.equal(orders().length, 0);
  assert.match(await textOf(page, "#orders button.main"), /Confirm: land, vehicle 3/);
  await page.locator("#orders button.main").click();
  await until("result", async () => (await textOf(page, "#orders .result")) === "taken by 7 of 8; 3 does not answer");
  assert.deepEqual(orders(), [{ type: "order", verb: "land", vehicles: ["3"], teams: null, token: "" }]);
}));

test("the past before the page was opened is unknown, and no vehicle is silent in it", () => withSwarm({ skip_s: 60 }, async ({ page }) => {
  await page.waitForTimeout(1000);
  const box = await page.locator("#time-bar").boundingBox();
  await page.mouse.click(box.x + box.width / 4, box.y + box.height / 2);
  await until("unknown", async () => /^unknown/.test(await textOf(page, "#status-text")));
  assert.equal(await page.locator("#status").getAttribute("data-level"), "none");
  assert.equal(await textOf(page, "#status-reasons"), "");
  await until("links", async () => (await textOf(page, "#links-text")) === "unknown");
  await until("row", async () => /unknown/.test(await rowOf(page, "1").textContent()));
  assert.doesNotMatch(await rowOf(page, "1").getAttribute("class") ?? "", /gone/);
  assert.equal(await page.locator("#table td.bad, #table td.warn").count(), 0);
  await page.keyboard.press("Home");
  await until("first picture", async () => /formation/.test(await rowOf(page, "1").textContent()));
  await page.keyboard.press("End");
  await until("now", async () => (await textOf(page, "#now")) === "live");
}));

test("a lost connection leaves a time of which nothing is known", async () => {
  let mock = await serve({});
  mock.skip(60);
  const { page } = await open(browser, mock.url);
  await until("picture", async () => (await page.locator("#table tbody tr").count()) === 4);
  const { port, swarm } = mock;
  await mock.stop();
  await page.waitForTimeout(5000);
  mock = await serve({ port });
  mock.swarm.t_s = swarm.t_s + 5;
  await until("live again", async () => !(await page.locator("#banner").isVisible()) && (await textOf(page, "#now")) === "live");
  await until("unknown", async () => {
    for (let at = 0; at < 8; at += 1) {
      await page.keyboard.press("ArrowLeft");
      await page.waitForTimeout(150);
      if (/^unknown/.test(await textOf(page, "#status-text"))) return true;
    }
    await page.keyboard.press("End");
    return false;
  });
  await page.close();
  await mock.stop();
});

test("a healthy fleet of four teams has no partitions", () => withSwarm({ vehicles: 16, teams: 4, skip_s: 60 }, async ({ mock, page }) => {
  await until("links", async () => /^all receive all of their team/.test(await textOf(page, "#links-text")));
  assert.equal(await page.locator("#links-text").getAttribute("data-level"), "ok");
  mock.swarm.cut(["3/1"]);
  await until("partitions", async () => (await textOf(page, "#links-text")) === "team 3: 2 partitions: 3/1 | 3/2, 3/3, 3/4");
}));

test("an event from before the page was opened has its time in the flight", () => withSwarm({ skip_s: 60 }, async ({ mock, page }) => {
  mock.swarm.events.length = 0;
  mock.swarm.events.push({ type: "event", t_s: null, at_ms: Date.now() - 10_000, vehicle: "1", text: "at altitude", level: "info" });
  const t_s = mock.swarm.t_s - 10;
  await page.reload();
  await until("time", async () => /^\d\d:\d\d$/.test(await textOf(page, "#events time")));
  const [minutes, seconds] = (await textOf(page, "#events time")).split(":").map(Number);
  assert.ok(Math.abs(60 * minutes + seconds - t_s) < 5, `${minutes}:${seconds}, it was at ${t_s} s`);
}));

test("map and plots are drawn anew when their size changes, also while nothing arrives", () => withSwarm({ skip_s: 60, size: { width: 390, height: 844 } }, async ({ mock, page }) => {
  const shown = () => page.evaluate(() => [...document.querySelectorAll("canvas")].map((canvas) => {
    const [across, down] = [canvas.width / canvas.clientWidth, canvas.height / canvas.clientHeight];
    return { id: canvas.id, off: Math.max(across / down, down / across), size: `${canvas.clientWidth}x${canvas.clientHeight}` };
  }));
  await until("plots", async () => (await shown()).every(({ off }) => off < 1.02));
  mock.quiet(true);
  await until("banner", async () => page.locator("#banner").isVisible());
  const check = (what) => until(what, async () => (await shown()).every(({ off }) => off < 1.02));
  await check("with the banner");
  await page.setViewportSize({ width: 844, height: 390 });
  await check("on its side");
  await page.locator("#map-panel").evaluate((panel) => (panel.style.height = "20rem"));
  await check("a map of another height");
  for (const id of ["map", "plot-centre", "plot-pairs", "plot-altitude"]) {
    assert.ok((await pixelsOf(page, `#${id}`, "muted")) > 20, `${id} is drawn again`);
  }
}));

test("every plot has room, and the legend leaves the scale free, on every screen", async () => {
  for (const [width, height] of [[1440, 900], [1366, 650], [1024, 768], [844, 390], [740, 360], [390, 844], [360, 640]]) {
    await withSwarm({ vehicles: 16, teams: 4, skip_s: 60, size: { width, height } }, async ({ page }) => {
      for (const id of ["plot-centre", "plot-pairs", "plot-altitude"]) {
        const box = await page.locator(`#${id}`).boundingBox();
        assert.ok(box.height >= 50 && box.width >= 100, `${id} at ${width}x${height}: ${box.width} by ${box.height}`);
      }
      const [map, legend] = [await page.locator("#map").boundingBox(), await page.locator("#legend").boundingBox()];
      const rem = await page.evaluate(() => parseFloat(getComputedStyle(document.documentElement).fontSize));
      // The scale is in the lower right corner of the map, at most a quarter of it wide.
      const left = map.x + map.width - Math.min(map.width / 4, 10 * rem) - 1.2 * rem;
      assert.ok(legend.x + legend.width <= left || legend.y >= map.y + map.height - 1, `legend at ${width}x${height}`);
      assert.ok((await page.evaluate(() => document.documentElement.scrollWidth)) <= width, `${width}x${height}`);
    });
  }
});

test("a page whose WebSocket is refused names the reason", async () => {
  const why = "a page of 127.0.0.1 may not read this server: start the server with --name 127.0.0.1";
  for (const [refusal, banner] of [[[403, why], why], [[421, why], why], [[204, ""], /proxy .* Upgrade and Connection/]]) {
    const mock = await serve({ refusal });
    const { page } = await open(browser, mock.url);
    await until("banner", async () => (await textOf(page, "#banner")).replace(/\s+/g, " ").match(banner));
    await page.close();
    await mock.stop();
  }
});

test("nothing on the page needs more room than a phone has", () => withSwarm({ skip_s: 60, size: { width: 390, height: 844 } }, async ({ page }) => {
  const width = await page.evaluate(() => document.documentElement.scrollWidth);
  assert.ok(width <= 390, `${width} px`);
  assert.ok((await page.locator("#map").boundingBox()).height > 300);
}));

test("the theme follows the system and the switch", () => withSwarm({ skip_s: 10, theme: "light" }, async ({ page }) => {
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  assert.equal(await ground(), "rgb(247, 249, 251)");
  await page.keyboard.press("n");
  assert.equal(await ground(), "rgb(10, 16, 23)");
}));
