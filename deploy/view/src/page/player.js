// Which picture is shown: the newest, one of the last ten minutes, or one of a recording, and how fast time passes.

import { Frame } from "./frame.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 32, 64];
/** Keys nearer to the newest picture than this are "now", s. */
const NOW_S = 0.3;

export class Player {
  /** `send` sends a message to the server: a recording is played there, the past of a live flight here. */
  constructor(swarm, history, send) {
    this.swarm = swarm;
    this.history = history;
    this.send = send;
    this.speed = 1;
    this.isPlaying = true;
    /** Key of the picture shown while looking back; `null` shows the newest picture. */
    this.cursor = null;
    this.key = swarm.from_s;
  }

  /** Asks the server to play a recording from the present place. */
  start(at_s = this.swarm.from_s) {
    if (!this.swarm.isLive) this.ask(at_s);
  }

  ask(at_s) {
    this.key = at_s;
    this.send({ type: "play", at_s, speed: this.isPlaying ? this.speed : 0 });
  }

  /** The picture to show; `null` before the first one. */
  get frame() {
    const { cursor, history } = this;
    if (cursor === null || !history.newest) return history.newest;
    return history.at(cursor) ?? this.unknown(cursor);
  }

  /** The picture of a time of which nothing is known, the same one while it is shown. */
  unknown(key) {
    if (this.blank?.key !== key || this.blank.swarm !== this.swarm) {
      const offset_s = this.history.offset_s;
      const frame = Frame.unknown(this.swarm, key, offset_s === null ? null : key - offset_s);
      this.blank = { key, swarm: this.swarm, frame };
    }
    return this.blank.frame;
  }

  /** Whether the picture is of the past although the flight is live. */
  get isLookingBack() {
    return this.swarm.isLive && this.cursor !== null;
  }

  /** Where the picture is, as a key. */
  get position() {
    return this.cursor ?? this.history.newest?.key ?? this.swarm.from_s;
  }

  /** First and last key that can be shown. */
  get range() {
    if (!this.swarm.isLive) return [this.swarm.from_s, Math.max(this.swarm.to_s ?? 0, this.swarm.from_s + 1)];
    const newest = this.history.newest?.key ?? 0;
    return [Math.min(this.history.frames[0]?.key ?? newest, newest - 60), newest];
  }

  /** Goes to this key. */
  seek(key) {
    const [from, to] = this.range;
    const at = Math.min(Math.max(key, from), to);
    if (!this.swarm.isLive) {
      this.ask(at);
    } else if (at >= to - NOW_S) {
      this.toNow();
    } else {
      this.cursor = at;
    }
  }

  /** Goes to the first picture. */
  toBegin() {
    this.seek(this.swarm.isLive ? (this.history.frames[0]?.key ?? this.range[0]) : this.range[0]);
  }

  /** Goes back to now; a recording goes to its end. */
  toNow() {
    if (!this.swarm.isLive) {
      this.seek(this.range[1]);
      return;
    }
    this.cursor = null;
    this.isPlaying = true;
    this.speed = 1;
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    if (!this.swarm.isLive) {
      const isAtEnd = this.position >= this.range[1] - NOW_S;
      this.ask(this.isPlaying && isAtEnd ? this.range[0] : this.position);
    } else if (this.isPlaying) {
      if (this.cursor !== null && this.cursor >= this.range[1] - NOW_S) this.toNow();
    } else {
      this.cursor = this.position;
    }
  }

  /** Moves by so many seconds and pauses. */
  step(seconds) {
    const from = this.position;
    this.isPlaying = false;
    this.seek(from + seconds);
  }

  /** Plays faster or slower: by so many places of the list of speeds. */
  changeSpeed(places) {
    const at = SPEEDS.indexOf(this.speed) + places;
    this.speed = SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)];
    // Now cannot be played faster; slower falls behind it.
    if (this.swarm.isLive && this.cursor === null) {
      if (this.speed < 1) this.cursor = this.position;
      else this.speed = 1;
    }
    if (!this.swarm.isLive) this.ask(this.position);
  }

  /** Lets so much time of the viewer pass. Whether another picture is due. */
  tick(seconds) {
    if (!this.isLookingBack || !this.isPlaying) return false;
    this.cursor += seconds * this.speed;
    if (this.cursor >= this.range[1] - NOW_S) this.toNow();
    return true;
  }
}
