// The view of the map: metres north and east to pixels, moved by mouse, fingers and keys.

import { pointIn } from "./dom.js";

const NEAREST_M_PX = 0.02;
const FARTHEST_M_PX = 500;

export class Camera {
  constructor() {
    this.north = 0;
    this.east = 0;
    /** Metres of a pixel. */
    this.m_px = 1;
    this.width = 1;
    this.height = 1;
    /** Whether the view follows the swarm by itself. */
    this.isAutomatic = true;
    this.goal = null;
  }

  x(east) {
    return this.width / 2 + (east - this.east) / this.m_px;
  }

  y(north) {
    return this.height / 2 - (north - this.north) / this.m_px;
  }

  /** Position under a pixel, m north and east. */
  place(x, y) {
    return [this.north - (y - this.height / 2) * this.m_px, this.east + (x - this.width / 2) * this.m_px];
  }

  /** Whether a point, with so many pixels around it, is in the picture. */
  sees(north, east, margin = 0) {
    const [x, y] = [this.x(east), this.y(north)];
    return x > -margin && y > -margin && x < this.width + margin && y < this.height + margin;
  }

  /** Zooms around a pixel; the view does not follow the swarm any more. */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const [north, east] = this.place(x, y);
    this.m_px = Math.min(Math.max(this.m_px / factor, NEAREST_M_PX), FARTHEST_M_PX);
    const [after_north, after_east] = this.place(x, y);
    this.north += north - after_north;
    this.east += east - after_east;
    this.isAutomatic = false;
    this.goal = null;
  }

  /** Moves the picture by so many pixels. */
  pan(dx, dy) {
    this.north += dy * this.m_px;
    this.east -= dx * this.m_px;
    this.isAutomatic = false;
    this.goal = null;
  }

  /** Moves a position to the middle of the picture. */
  centre(north, east) {
    Object.assign(this, { north, east, isAutomatic: false, goal: null });
  }

  /**
   * Shows these bounds `[south, west, north, east]`, m. The view is changed only if they leave it or became much smaller, so
   * that it does not breathe with the swarm.
   */
  show(bounds, isImmediate = false) {
    const [south, west, north, east] = bounds;
    const margin = Math.min(56, 0.09 * Math.min(this.width, this.height));
    const m_px = Math.min(Math.max(
      (north - south) / (this.height - 2 * margin), (east - west) / (this.width - 2 * margin), 0.1,
    ), FARTHEST_M_PX);
    const goal = { north: (north + south) / 2, east: (east + west) / 2, m_px };
    const present = this.goal ?? this;
    const shift = Math.hypot(goal.north - present.north, goal.east - present.east) / m_px;
    const isNear = present.m_px >= 0.97 * m_px && present.m_px < 1.35 * m_px && shift < 0.5 * margin;
    if (isImmediate) Object.assign(this, goal, { goal: null });
    else if (!isNear) this.goal = goal;
  }

  /** Moves towards the goal. Whether there is more to move. */
  step() {
    if (!this.goal) return false;
    const share = 0.25;
    this.north += share * (this.goal.north - this.north);
    this.east += share * (this.goal.east - this.east);
    this.m_px *= (this.goal.m_px / this.m_px) ** share;
    const rest = Math.hypot(this.goal.north - this.north, this.goal.east - this.east) / this.m_px;
    if (rest < 0.5 && Math.abs(Math.log(this.goal.m_px / this.m_px)) < 0.002) {
      Object.assign(this, this.goal, { goal: null });
    }
    return true;
  }
}

/** Lets mouse, wheel and fingers move the camera; `clicked(x, y, isAdding)` and `hovered(x, y)` report the rest. */
export function steer(canvas, camera, { changed, clicked, hovered, left }) {
  const fingers = new Map();
  let moved = 0;
  const at = (event) => pointIn(canvas, event);
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, at(event));
    if (fingers.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = at(event);
    const before = fingers.get(event.pointerId);
    if (!before) {
      hovered(x, y);
      return;
    }
    const [dx, dy] = [x - before[0], y - before[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    if (moved < 4) return;
    const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const reach = (a, b) => Math.max(10, Math.hypot(a[0] - b[0], a[1] - b[1]));
      camera.zoom(reach([x, y], other) / reach(before, other), (x + other[0]) / 2, (y + other[1]) / 2);
      camera.pan(dx / 2, dy / 2);
    } else {
      camera.pan(dx, dy);
    }
    fingers.set(event.pointerId, [x, y]);
    changed();
  });
  const lift = (event) => {
    const wasAlone = fingers.delete(event.pointerId) && fingers.size === 0;
    if (wasAlone && moved < 4 && event.type === "pointerup") {
      const isAdding = event.shiftKey || event.ctrlKey || event.metaKey;
      clicked(...at(event), isAdding);
    }
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", left);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const step = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 0.06 : 0.0015;
    camera.zoom(Math.exp(-event.deltaY * step), ...at(event));
    changed();
  }, { passive: false });
}
