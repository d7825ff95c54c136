// Orders to the swarm. The page shows them only if the server was started with orders allowed.

import { byId, element, setText } from "./dom.js";
import * as format from "./format.js";

/** Verbs with what they do, as the operator reads it before sending; the same as those of `skein order`. */
const VERBS = [
  ["hold", "stop at the present position and altitude"],
  ["goto", "fly on at this step of the mission or a later one; ends a hold"],
  ["land", "descend at the present position; another order recalls a vehicle until it is down"],
  ["abort", "give up: descend at the present position, and ignore all later orders"],
  ["release", "give the controls of the selected vehicles to human pilots, until a goto that names them takes them back"],
];

export class Orders {
  /** `send(order)` sends an order; `selection()` returns the ids of the selected vehicles, `swarm()` the swarm. */
  constructor({ send, selection, swarm }) {
    this.send = send;
    this.selection = selection;
    this.swarm = swarm;
    this.dialog = byId("orders");
    this.verb = "hold";
    this.verbs = element("div", { className: "verbs" }, ...VERBS.map(([verb, text]) => {
      const input = element("input", { type: "radio", name: "verb", value: verb, checked: verb === "hold" });
      input.addEventListener("change", () => this.choose(verb));
      return element("label", {}, input, element("b", { textContent: verb }), ` ${text}`);
    }));
    this.step = element("input", { type: "number", min: "0", value: "0", attributes: { "aria-label": "step" } });
    this.stepLine = element("label", { className: "line" }, "step ", this.step);
    this.scope = element("p", { className: "line" });
    this.teams = element("input", { type: "text", autocomplete: "off", placeholder: "all, or such as 1, 3" });
    this.teams.addEventListener("input", () => this.choose(this.verb));
    this.teamLine = element("label", { className: "line" }, "teams ", this.teams);
    this.token = element("input", { type: "password", autocomplete: "off" });
    this.tokenLine = element("label", { className: "line" }, "token ", this.token);
    this.result = element("p", { className: "result", attributes: { role: "status" } });
    this.button = element("button", { type: "button", className: "main" });
    this.button.addEventListener("click", () => this.press());
    const close = element("button", { type: "button", textContent: "Close" });
    close.addEventListener("click", () => this.dialog.close());
    this.dialog.append(
      element("h2", { textContent: "Orders" }), this.verbs, this.stepLine, this.scope, this.teamLine, this.tokenLine, this.result,
      element("footer", {}, close, this.button),
    );
    byId("orders-button").addEventListener("click", () => this.open());
  }

  open() {
    setText(this.result, "");
    this.choose(this.verb);
    this.dialog.showModal();
  }

  choose(verb) {
    this.verb = verb;
    this.isConfirming = false;
    this.stepLine.hidden = verb !== "goto";
    const ids = this.selection();
    const isFleet = this.swarm().teams.some(({ name }) => name !== null);
    this.teamLine.hidden = !isFleet || ids.length > 0;
    this.tokenLine.hidden = !this.swarm().needsToken;
    const isWithout = verb === "release" && ids.length === 0;
    this.button.disabled = isWithout || this.chosenTeams() === undefined;
    const all = isWithout ? "Select the vehicles that human pilots are to fly." : "To all vehicles. Select vehicles to order only those.";
    setText(this.scope, ids.length ? `To ${format.count(ids.length, "selected vehicle")}: ${format.ids(ids)}` : all);
    setText(this.button, "Order …");
  }

  /** Numbers of the teams to order; `null` for all, `undefined` if what was typed is no list of numbers. */
  chosenTeams() {
    const text = this.teamLine.hidden ? "" : this.teams.value.trim();
    if (text === "") return null;
    const numbers = text.split(/[\s,]+/).map(Number);
    return numbers.every((number) => Number.isInteger(number) && number > 0) ? numbers : undefined;
  }

  /** The first press asks for confirmation, the second one sends. */
  press() {
    const ids = this.selection();
    const teams = this.chosenTeams();
    const all = teams ? `team ${teams.join(", ")}` : "all vehicles";
    const whom = ids.length ? `vehicle ${format.ids(ids)}` : all;
    if (!this.isConfirming) {
      this.isConfirming = true;
      setText(this.button, `Confirm: ${this.verb}${this.verb === "goto" ? ` step ${this.step.value}` : ""}, ${whom}`);
      return;
    }
    const order = { type: "order", verb: this.verb, vehicles: ids.length ? ids : null, teams, token: this.token.value };
    if (this.verb === "goto") order.step = Math.max(0, Math.round(Number(this.step.value) || 0));
    this.send(order);
    this.choose(this.verb);
    this.result.dataset.ok = "";
    setText(this.result, "sent, waiting for the vehicles");
  }

  /** Shows what became of the order. */
  answer({ text, ok }) {
    this.result.dataset.ok = String(ok === true);
    setText(this.result, String(text));
  }
}
