// Talks to the stand-in by UDP through @shiari/xplane-node-udp-client, which others wrote. Fails with an error.

const assert = require('node:assert');
const { setTimeout: sleep } = require('node:timers/promises');
const XPlaneClient = require('@shiari/xplane-node-udp-client');

const LATITUDE = 'sim/flightmodel/position/latitude';
const RUNNING = 'sim/time/total_running_time_sec';
const JOYSTICK = 'sim/operation/override/override_joystick';
const PAUSED = 'sim/time/paused';

async function until(what, isReached) {
  const end = Date.now() + 5000;
  while (!isReached()) {
    assert(Date.now() < end, what);
    await sleep(20);
  }
}

async function main() {
  const [port, latitude] = [Number(process.argv[2]), Number(process.argv[3])];
  // The client prints a line for each value that it passes on.
  const print = console.log;
  console.log = () => {};
  const client = new XPlaneClient({ host: '127.0.0.1', port });
  const latest = {};
  let updates = 0;
  const keep = (path, value) => {
    latest[path] = value;
    updates += path === RUNNING ? 1 : 0;
  };
  const paths = [LATITUDE, RUNNING, JOYSTICK, PAUSED];
  for (const path of paths) client.requestDataRef(path, 20, keep);
  await until('the latitude in single precision', () => Math.abs(latest[LATITUDE] - latitude) < 1e-5);
  updates = 0;
  const begin = performance.now();
  await sleep(2000);
  const perSecond = (1000 * updates) / (performance.now() - begin);
  assert(perSecond >= 17.5 && perSecond <= 21, `20 a second: ${perSecond}`);
  for (const wanted of [1, 0]) {
    client.setDataRef(JOYSTICK, wanted);
    await until('the written dataref', () => latest[JOYSTICK] === wanted);
  }
  for (const [command, wanted] of [['sim/operation/pause_on', 1], ['sim/operation/pause_off', 0]]) {
    client.sendCommand(command);
    await until(command, () => latest[PAUSED] === wanted);
  }
  for (const path of paths) client.requestDataRef(path, 0, keep);
  await sleep(500);
  updates = 0;
  await sleep(500);
  assert.strictEqual(updates, 0, 'silence after the subscription');
  print(`UDP: ${perSecond.toFixed(1)} values a second, a dataref written, commands executed, silence after the subscription`);
}

main().then(() => process.exit(0), (error) => {
  console.error(error);
  process.exit(1);
});
