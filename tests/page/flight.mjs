// Real flights and their page: processes of the program that `SKEIN_PROGRAM` names, in a folder of their own.

import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { mkdtemp, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { until } from "./browser.mjs";

const PROGRAM = process.env.SKEIN_PROGRAM ?? "skein";

/** A folder for swarms, which ends all their processes with `remove`. */
export class Place {
  static async make() {
    const place = new Place();
    place.folder = await mkdtemp(join(tmpdir(), "skein-flight-"));
    place.children = [];
    return place;
  }

  get out() {
    return join(this.folder, "out");
  }

  /** Starts the program; `lines` collects what it prints on stdout, `errors` what it prints on stderr. */
  start(...args) {
    const env = { ...process.env, XDG_RUNTIME_DIR: join(this.folder, "runtime") };
    const child = spawn(PROGRAM, args, { cwd: this.folder, env, stdio: ["ignore", "pipe", "pipe"] });
    const started = { child, lines: [], errors: [] };
    createInterface({ input: child.stdout }).on("line", (line) => started.lines.push(line));
    createInterface({ input: child.stderr }).on("line", (line) => started.errors.push(line));
    started.ended = new Promise((done) => child.on("exit", (status) => done(status)));
    this.children.push(started);
    return started;
  }

  /** Starts `skein view` and waits for its address. */
  async view(...args) {
    const started = this.start("view", ...args);
    const address = () => [...started.lines, ...started.errors].map((line) => /http:\/\/[\w.:[\]]+/.exec(line)?.[0]).find(Boolean);
    const { found } = await until("address of the page", async () => {
      if (started.child.exitCode !== null) throw new Error(`skein view ended:\n${started.errors.join("\n")}`);
      return address();
    });
    return { ...started, url: `${found}/`, port: Number(new URL(found).port) };
  }

  /** Writes a scenario and starts to fly it; progress is printed as JSON. */
  async fly(scenario, ...args) {
    const file = join(this.folder, "scenario.toml");
    await writeFile(file, scenario);
    return this.start("fly", file, "--out", this.out, "--plant", "builtin", "--json", "--no-view", ...args);
  }

  /** Process of the agent of a vehicle. */
  async agent(id) {
    const numbers = (await readdir("/proc")).filter((name) => /^\d+$/.test(name));
    for (const number of numbers) {
      const line = await readFile(`/proc/${number}/cmdline`, "utf8").catch(() => "");
      const text = line.replaceAll("\0", " ");
      if (text.includes(this.folder) && text.includes(`agents/${id}.toml --child`)) return Number(number);
    }
    return null;
  }

  async remove() {
    for (const { child } of this.children) if (child.exitCode === null) child.kill("SIGKILL");
    for (let id = 1; id <= 64; id += 1) {
      const agent = existsSync(this.out) ? await this.agent(id) : null;
      if (agent) process.kill(agent, "SIGKILL");
      else if (id > 16) break;
    }
    await rm(this.folder, { recursive: true, force: true, maxRetries: 5, retryDelay: 200 });
  }
}

/** The newest progress of a flight, as `skein fly --json` prints it. */
export function progress(flight) {
  const last = flight.lines.findLast((line) => line.includes('"progress"'));
  return last ? JSON.parse(last) : null;
}
