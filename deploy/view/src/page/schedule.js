// When the parts of the page are drawn: each at most so often, and few at a time, so that a frame stays short.

/** Time in a frame after which no further part is begun, ms. */
const ENOUGH_MS = 3;

export class Schedule {
  constructor() {
    this.parts = [];
    this.frame = null;
    this.timer = null;
  }

  /** Adds a part that `draw()` draws at most every `period_ms`. It may return `true` to be drawn again in the next frame. */
  add(period_ms, draw) {
    this.parts.push({ period_ms, draw, isDue: true, drawn_ms: -Infinity });
  }

  /** Requests all parts; `isAtOnce` lets them not wait for their period. */
  request(isAtOnce = false) {
    for (const part of this.parts) {
      part.isDue = true;
      if (isAtOnce) part.drawn_ms = -Infinity;
    }
    this.wake();
  }

  wake() {
    this.frame ??= requestAnimationFrame((now) => {
      this.frame = null;
      this.run(now);
    });
  }

  run(now) {
    const begun = performance.now();
    // The map, which has no period, comes first; then the part that waits longest.
    const wait = (part) => part.drawn_ms + part.period_ms - now;
    const due = this.parts.filter((part) => part.isDue && wait(part) <= 0);
    const first = due.filter(({ period_ms }) => period_ms === 0);
    const later = due.filter(({ period_ms }) => period_ms > 0).sort((a, b) => wait(a) - wait(b));
    for (const part of [...first, ...later]) {
      // One of the later parts is always drawn, so that a slow map does not starve them.
      const isNext = part.period_ms === 0 || part === later[0];
      if (!isNext && performance.now() - begun > ENOUGH_MS) break;
      part.isDue = part.draw() === true;
      part.drawn_ms = now;
    }
    this.plan(Math.min(...this.parts.filter(({ isDue }) => isDue).map(wait)));
  }

  /** Draws again when the next part is due. */
  plan(wait_ms) {
    clearTimeout(this.timer);
    if (wait_ms <= 0) this.wake();
    else if (wait_ms < Infinity) this.timer = setTimeout(() => this.wake(), wait_ms);
  }
}
