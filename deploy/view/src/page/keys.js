// The keyboard, and the help that documents it.

import { byId, element } from "./dom.js";

/** Every key with what it does; `actions` has a function for each name. */
const KEYS = [
  ["space", "pause or play", " ", "toggle"],
  ["← →", "one second back or forward; ten with shift", null, null],
  ["End", "back to now; in a recording to its end", "End", "now"],
  ["Home", "to the beginning of what can be shown", "Home", "begin"],
  [", .", "play slower or faster", null, null],
  ["j k", "select the next or the previous vehicle", null, null],
  ["c", "move the selected vehicle to the middle of the map", "c", "centre"],
  ["Esc", "select nothing", "Escape", "clear"],
  ["+ − 0", "map: nearer, farther, show all and follow", null, null],
  ["l t f g", "map: links, trails, field of the selected vehicle, mission", null, null],
  ["m", "matrix in large", "m", "matrix"],
  ["n", "dark or light", "n", "theme"],
  ["o", "orders, if allowed", "o", "orders"],
  ["?", "this help", "?", "help"],
];

const READ = [
  ["links", "The half of a link at a vehicle shows how old the newest message is that this vehicle received from the other. "
    + "Blue is fresh, yellow with long dashes is stale, red with short dashes and a bar is lost. A link with one red half works one way."],
  ["matrix", "A row for each receiver, a column for each sender. In a divided swarm the members of a partition stand together."],
  ["ghost", "A hatched disc is a vehicle out of contact, where dead reckoning puts it."],
  ["circles", "The dotted circles around vehicles touch at the safety distance."],
  ["arrows", "The field of the selected vehicle: the direction in which the formation law would move it, from each place. "
    + "The length is the square root of the magnitude."],
];

/** Connects the keyboard to `actions`, and fills the help. */
export function startKeys(actions) {
  const help = byId("help");
  const close = element("button", { type: "button", textContent: "Close" });
  close.addEventListener("click", () => help.close());
  const rows = (list) => list.flatMap(([name, text]) => [element("dt", { textContent: name }), element("dd", { textContent: text })]);
  help.append(
    element("h2", { textContent: "Keys" }), element("dl", {}, ...rows(KEYS)),
    element("h2", { textContent: "How to read it" }), element("dl", {}, ...rows(READ)),
    element("footer", {}, close),
  );
  const open = () => (help.open ? help.close() : help.showModal());
  byId("help-button").addEventListener("click", open);
  const direct = new Map(KEYS.filter(([, , key]) => key).map(([, , key, name]) => [key, name]));
  const all = { ...actions, help: open };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("input, dialog:not(#help)")) return;
    const isButton = event.target.closest?.("button") && (event.key === " " || event.key === "Enter");
    if (isButton) return;
    if (press(event, direct, all)) event.preventDefault();
  });
}

function press({ key, shiftKey }, direct, actions) {
  const seconds = shiftKey ? 10 : 1;
  const name = direct.get(key);
  if (name === "clear" && byId("help").open) return false;
  if (name) actions[name]();
  else if (key === "ArrowLeft") actions.step(-seconds);
  else if (key === "ArrowRight") actions.step(seconds);
  else if (key === ",") actions.faster(-1);
  else if (key === ".") actions.faster(1);
  else if (key === "j") actions.next(1);
  else if (key === "k") actions.next(-1);
  else if (key === "+" || key === "=") actions.zoom(1.4);
  else if (key === "-") actions.zoom(1 / 1.4);
  else if (key === "0") actions.fit();
  else return actions.layer(key);
  return true;
}
