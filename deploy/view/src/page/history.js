// The last ten minutes of pictures, in the memory of the page.

import { Frame } from "./frame.js";

const KEPT_S = 600;
/** Younger pictures are all kept; of older ones two a second. */
const WHOLE_S = 30;
const THINNED_S = 0.5;
/** With no picture for so long, nothing is known of the time between, s: a live server sends ten a second. */
const GAP_S = 2;
/** Large swarms look back less far rather than fill the memory. */
const KEPT_BYTES = 160e6;

export class History {
  constructor(swarm) {
    this.swarm = swarm;
    /** Pictures in the order of their keys. */
    this.frames = [];
    /** The picture received last. */
    this.newest = null;
    this.bytes = 0;
    this.thinned = -Infinity;
    /** Times of which a live flight's page received nothing, between the pictures: `[from, to]` in the order of keys. */
    this.gaps = [];
    /** The oldest pictures were forgotten. */
    this.hasForgotten = false;
  }

  /** Takes up a snapshot. */
  add(snapshot, crowd) {
    const frame = new Frame(this.swarm, snapshot, crowd);
    const at = this.after(frame.key);
    const same = this.frames[at - 1];
    if (same && same.key === frame.key) {
      this.frames[at - 1] = frame;
    } else {
      this.frames.splice(at, 0, frame);
    }
    const before = this.frames[at - 1];
    if (this.swarm.isLive && before && frame.key - before.key > GAP_S) this.gaps.push([before.key, frame.key]);
    this.newest = frame;
    if (Math.abs(frame.key - this.thinned) >= 1) {
      this.thinned = frame.key;
      this.thin(frame.key);
    }
    return frame;
  }

  /** Thins out the pictures that are far from `key`, and forgets the farthest if there are too many. */
  thin(key) {
    let last = -Infinity;
    let bytes = 0;
    this.frames = this.frames.filter((frame) => {
      const distance = Math.abs(key - frame.key);
      if (distance > KEPT_S) {
        this.hasForgotten ||= this.swarm.isLive;
        return false;
      }
      if (distance > WHOLE_S) {
        if (frame.key - last < THINNED_S - 0.01) return false;
        frame.pack();
      }
      last = frame.key;
      bytes += frame.bytes;
      return true;
    });
    while (bytes > KEPT_BYTES && this.frames.length > 2) {
      const [first, end] = [this.frames[0], this.frames.at(-1)];
      const dropped = key - first.key >= end.key - key ? this.frames.shift() : this.frames.pop();
      bytes -= dropped.bytes;
    }
    const first = this.frames[0]?.key;
    this.gaps = this.gaps.filter(([, to]) => to > first);
  }

  /** Whether something between these keys is unknown. */
  isBroken(from, to) {
    return this.gaps.some((gap) => from <= gap[0] && gap[1] <= to);
  }

  /** Number of pictures up to and with this key. */
  after(key) {
    let [low, high] = [0, this.frames.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.frames[middle].key <= key) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The picture at this key: the last one up to it; `null` if nothing was received of that time. */
  at(key) {
    const found = this.frames[this.after(key) - 1];
    // Who looks at the oldest picture keeps seeing the oldest one.
    if (!found) return this.hasForgotten ? (this.frames[0] ?? null) : null;
    return this.gaps.some(([from, to]) => from + GAP_S < key && key < to && found.key <= from) ? null : found;
  }

  /** The pictures with keys from `from` to `to`, both included. */
  between(from, to) {
    let low = this.after(from);
    while (low > 0 && this.frames[low - 1].key === from) low -= 1;
    return this.frames.slice(low, this.after(to));
  }

  /** What to add to a flight time to get a key, s. */
  get offset_s() {
    if (!this.swarm.isLive) return 0;
    const timed = this.newest?.t_s !== null ? this.newest : this.frames.findLast((frame) => frame.t_s !== null);
    return timed ? timed.key - timed.t_s : null;
  }
}
