// Small helpers for the document. Text from the network is set as text only, never as markup.

import { colours } from "./theme.js";

/** The element with this id, which the page has. */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element #${id}`);
  return found;
}

/** A new element with properties, attributes (in `attributes`) and children: elements or texts. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  const { attributes, ...own } = properties;
  Object.assign(made, own);
  for (const [name, value] of Object.entries(attributes ?? {})) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** Sets the text of an element, and touches the document only on a change. */
export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/** Sets the class of an element, and touches the document only on a change. */
export function setClass(target, name) {
  if (target.className !== name) target.className = name;
}

/** Shows or hides an element. */
export function show(target, isShown) {
  if (target.hidden === isShown) target.hidden = !isShown;
}

/**
 * Fits the pixels of a canvas to its box on the screen and returns its drawing context with the box's size. The unit of
 * drawing grows with the size of the text, so that lines and marks suit a phone and a wall. A canvas without a box has no context.
 */
export function contextOf(canvas) {
  const [width, height] = sizeOf(canvas);
  if (width === 0 || height === 0) return null;
  const density = Math.min(window.devicePixelRatio || 1, 2);
  const pixels = [Math.round(width * density), Math.round(height * density)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  const context = canvas.getContext("2d");
  context.setTransform(density * colours.unit, 0, 0, density * colours.unit, 0, 0);
  context.clearRect(0, 0, width / colours.unit, height / colours.unit);
  return { context, width: width / colours.unit, height: height / colours.unit };
}

// The sizes of canvases are observed: to ask for them would make the browser lay out the page in the middle of a frame.
const sizes = new WeakMap();
let resized = () => {};
const observer = new ResizeObserver((entries) => {
  for (const { target } of entries) sizes.set(target, [target.clientWidth, target.clientHeight]);
  resized();
});

/** Lets `handler()` know that a canvas has another size: until it is drawn again, its old picture is stretched. */
export function onResize(handler) {
  resized = handler;
}

function sizeOf(canvas) {
  if (!sizes.has(canvas)) {
    sizes.set(canvas, [canvas.clientWidth, canvas.clientHeight]);
    observer.observe(canvas);
  }
  return sizes.get(canvas);
}

/** A width of lines that is a little less than a pixel: such lines are drawn many times faster than wider ones. */
export function thin() {
  return 0.9 / colours.unit / (window.devicePixelRatio || 1);
}

/** Where a pointer is in a canvas, in units of drawing. */
export function pointIn(canvas, event) {
  const box = canvas.getBoundingClientRect();
  return [(event.clientX - box.left) / colours.unit, (event.clientY - box.top) / colours.unit];
}
