// The page behind reverse proxies: in a folder, with https, with the headers Host and Origin as different proxies leave them.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { createServer, request as ask } from "node:http";
import { createServer as createSecureServer } from "node:https";
import { connect } from "node:net";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { startBrowser, textOf, until } from "./browser.mjs";
import { Place } from "./flight.mjs";

const FOLDER = "/lab/swarm/";

let browser;
let place;
let secrets;

before(async () => {
  browser = await startBrowser();
  place = await Place.make();
  const [key, cert] = ["key.pem", "cert.pem"].map((name) => join(place.folder, name));
  execFileSync("openssl", [
    "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost", "-keyout", key, "-out", cert,
  ], { stdio: "ignore" });
  secrets = { key: readFileSync(key), cert: readFileSync(cert) };
});
after(async () => {
  await browser?.close();
  await place?.remove();
});

/**
 * A proxy that serves the page of `port` in a folder. It passes the header Host on, or writes that of the server
 * (`isRewriting`), and passes WebSockets on unless it `isPlain`.
 */
async function proxy(port, { isSecure = false, isRewriting = false, isPlain = false }) {
  const inside = (url) => url.slice(FOLDER.length - 1);
  const headersOf = (headers) => (isRewriting ? { ...headers, host: `127.0.0.1:${port}` } : headers);
  const serve = (from, to) => {
    if (!from.url.startsWith(FOLDER)) return to.writeHead(404).end();
    const headers = headersOf(from.headers);
    const passed = ask({ port, host: "127.0.0.1", method: from.method, path: inside(from.url), headers }, (answer) => {
      to.writeHead(answer.statusCode, answer.headers);
      answer.pipe(to);
    });
    passed.on("error", () => to.writeHead(502).end());
    return from.pipe(passed);
  };
  const server = isSecure ? createSecureServer(secrets, serve) : createServer(serve);
  const open = new Set();
  server.on("connection", (socket) => open.add(socket).size);
  server.on("upgrade", (from, socket) => {
    if (isPlain) return socket.end("HTTP/1.1 502 Bad Gateway\r\nContent-Length: 0\r\n\r\n");
    const to = connect(port, "127.0.0.1", () => {
      const lines = Object.entries(headersOf(from.headers)).map(([name, value]) => `${name}: ${value}\r\n`);
      to.write(`GET ${inside(from.url)} HTTP/1.1\r\n${lines.join("")}\r\n`);
      to.pipe(socket).pipe(to);
    });
    for (const one of [to, socket]) one.on("error", () => [to, socket].forEach((other) => other.destroy()));
    return open.add(to);
  });
  await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
  return {
    url: `http${isSecure ? "s" : ""}://localhost:${server.address().port}${FOLDER}`,
    stop: () => {
      server.close();
      for (const socket of open) socket.destroy();
    },
  };
}

/** Waits until the page of a proxy shows this on its banner. */
async function shows(behind, banner) {
  const page = await browser.newPage({ ignoreHTTPSErrors: true });
  try {
    await page.goto(behind.url);
    await until(`${behind.url}: ${banner}`, async () => banner.test((await textOf(page, "#banner")).replace(/\s+/g, " ").trim()));
  } finally {
    await page.close();
    behind.stop();
  }
}

/** What the page shows when its WebSocket is open, though no swarm flies. */
const OPEN = /no swarm named absent flies here/;

test("a proxy that passes Host on needs no option, in a folder and with https", async () => {
  const view = await place.view("--swarm", "absent", "--listen", "127.0.0.1:0");
  await shows(await proxy(view.port, {}), OPEN);
  await shows(await proxy(view.port, { isSecure: true }), OPEN);
});

test("behind a proxy that rewrites Host the page names the option, and works with it", async () => {
  const view = await place.view("--swarm", "absent", "--listen", "127.0.0.1:0");
  await shows(await proxy(view.port, { isRewriting: true }), /a page of localhost:\d+ may not read this server: .*--name localhost$/);
  const named = await place.view("--swarm", "absent", "--listen", "127.0.0.1:0", "--name", "LocalHost");
  await shows(await proxy(named.port, { isRewriting: true }), OPEN);
  await shows(await proxy(named.port, { isRewriting: true, isSecure: true }), OPEN);
});

test("a proxy that passes no WebSockets is named", async () => {
  const view = await place.view("--swarm", "absent", "--listen", "127.0.0.1:0");
  await shows(await proxy(view.port, { isPlain: true }), /proxy .* has to pass the headers Upgrade and Connection/);
});

test("an address without the slash of its folder shows what it lacks", async () => {
  const view = await place.view("--swarm", "absent", "--listen", "127.0.0.1:0");
  const behind = await proxy(view.port, {});
  const files = await fetch(`${behind.url}`).then((answer) => answer.text());
  assert.match(files, /did not arrive\. Behind a proxy its address ends with a slash/);
  assert.doesNotMatch(files, /(?:src|href)="\//, "every file is beside the page");
  behind.stop();
});
