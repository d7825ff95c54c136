// The page of `skein view`: takes the messages of the server and keeps every part of the page up to date.
//
// | module | what it does |
// | --- | --- |
// | connection | the WebSocket: reconnects, reads messages and binary positions |
// | swarm, frame, history, player | the swarm, one picture of it, the last ten minutes, which picture is shown |
// | reception | who receives whom: partitions, cuts, one-way links |
// | map, camera, map-* | the map, its view, its layers from the ground to the vehicles |
// | matrix, table, detail, events, plots, plot, time-bar, status, orders | the other parts of the page |
// | schedule | which part is drawn when, so that a frame stays short |
// | keys, theme, format, dom | keyboard and help, colours, numbers as text, the document |

import { Connection } from "./connection.js";
import { Detail } from "./detail.js";
import { byId, onResize, setText, show } from "./dom.js";
import { Events } from "./events.js";
import * as format from "./format.js";
import { History } from "./history.js";
import { startKeys } from "./keys.js";
import { MapView } from "./map.js";
import { Matrix } from "./matrix.js";
import { Orders } from "./orders.js";
import { Player } from "./player.js";
import { Plots } from "./plots.js";
import { analyse, describe } from "./reception.js";
import { Schedule } from "./schedule.js";
import { Banner, drawStatus } from "./status.js";
import { Swarm } from "./swarm.js";
import { Table } from "./table.js";
import { startTheme } from "./theme.js";
import { TimeBar } from "./time-bar.js";

/** A live server that sends nothing for so long is reported, and after a longer time dialled again, s. */
const QUIET_S = 3;
const DEAD_S = 15;
/** Most vehicles of a large swarm whose details are asked for. */
const MOST_DETAILS = 64;

class Page {
  constructor() {
    this.swarm = null;
    this.selected = new Set();
    this.schedule = new Schedule();
    this.banner = new Banner();
    const changed = () => this.schedule.request();
    const chosen = (indices, isAdding) => this.choose(indices, isAdding);
    const seek = (key) => this.control((player) => player.seek(key));
    this.map = new MapView({ chosen: (index, isAdding) => chosen(index === null ? [] : [index], isAdding), changed });
    this.matrix = new Matrix({ chosen: (index, isAdding) => chosen([index], isAdding) });
    this.table = new Table({ chosen });
    this.events = new Events({ seek });
    this.plots = new Plots({ seek });
    this.detail = new Detail({ closed: () => chosen([], false) });
    this.timeBar = new TimeBar({
      seek,
      toggle: () => this.control((player) => player.toggle()),
      now: () => this.control((player) => player.toNow()),
      faster: (places) => this.control((player) => player.changeSpeed(places)),
    });
    this.orders = new Orders({
      send: (order) => this.connection.send(order),
      selection: () => [...this.selected].map((index) => this.swarm.ids[index]),
      swarm: () => this.swarm,
    });
    const theme = startTheme(byId("theme-button"), () => this.schedule.request(true));
    this.plan();
    onResize(() => this.schedule.request(true));
    this.listen(theme);
    this.connection = new Connection({
      open: () => this.opened(),
      closed: (retry_s) => this.closed(retry_s),
      refused: (problem) => this.refused(problem),
      message: (message) => this.receive(message),
      crowd: (crowd) => (this.crowd = crowd),
    });
    setInterval(() => this.watch(), 500);
  }

  /** Which part is drawn how often. */
  plan() {
    const part = (period_ms, draw) => this.schedule.add(period_ms, () => (this.scene() ? draw(this.scene()) : false));
    this.schedule.add(0, () => this.drawMap());
    this.schedule.add(90, () => this.swarm && drawStatus(this.scene()?.frame));
    part(400, (scene) => this.drawReception(scene));
    part(400, (scene) => this.table.draw(scene));
    part(250, (scene) => this.detail.draw(scene));
    part(250, (scene) => this.timeBar.draw(scene));
    part(300, (scene) => this.events.draw(scene));
    for (const name of ["centre", "pairs", "altitude"]) part(600, (scene) => this.plots.draw(name, scene));
  }

  listen(theme) {
    startKeys({
      theme,
      toggle: () => this.control((player) => player.toggle()),
      now: () => this.control((player) => player.toNow()),
      begin: () => this.control((player) => player.toBegin()),
      step: (seconds) => this.control((player) => player.step(seconds)),
      faster: (places) => this.control((player) => player.changeSpeed(places)),
      next: (places) => this.selectNext(places),
      centre: () => this.selected.size && this.map.centre([...this.selected][0]),
      clear: () => this.choose([], false),
      zoom: (factor) => this.map.zoom(factor),
      fit: () => this.map.fit(),
      layer: (key) => this.map.toggleByKey(key),
      matrix: () => this.toggleMatrix(),
      orders: () => this.swarm?.hasOrders && this.orders.open(),
    });
    byId("links-panel").addEventListener("dblclick", () => this.toggleMatrix());
  }

  opened() {
    this.received_ms = performance.now();
    this.banner.set("connection", null);
    this.banner.set("refused", null);
  }

  /** Shows why the server refuses this page; `null` if it does not. */
  refused(problem) {
    this.banner.set("refused", problem);
    if (problem) this.banner.set("connection", null);
  }

  closed(retry_s) {
    this.received_ms = null;
    if (this.banner.has("refused")) return;
    const remedy = `Trying again in ${format.number(retry_s, 1)} s. The swarm flies on without this page.`;
    this.banner.set("connection", { text: "Connection to skein view lost.", remedy });
    this.banner.set("quiet", null);
  }

  /** Reports a live server that sends nothing. */
  watch() {
    if (!this.swarm?.isLive || this.received_ms === null) return;
    const quiet_s = (performance.now() - this.received_ms) / 1000;
    const remedy = "The picture is old. The page waits for the server.";
    const problem = { text: `No data from skein view for ${format.time(quiet_s)}.`, remedy };
    this.banner.set("quiet", quiet_s > QUIET_S ? problem : null);
    if (quiet_s > DEAD_S) {
      this.received_ms = performance.now();
      this.connection.restart();
    }
  }

  receive(message) {
    this.received_ms = performance.now();
    const take = {
      hello: () => this.begin(new Swarm(message)),
      snapshot: () => this.swarm && this.show(message),
      event: () => this.events.add(message),
      events: () => this.events.replace(message.events ?? []),
      problem: () => this.banner.set("problem", message.text ? message : null),
      ordered: () => this.orders.answer(message),
    }[message?.type];
    take?.();
    this.schedule.request();
  }

  /** Begins with a swarm. What was seen of it before a reconnection stays. */
  begin(swarm) {
    const isSame = this.swarm?.isSameAs(swarm);
    const resume_s = this.swarm && !swarm.isLive && this.swarm.name === swarm.name ? this.player.position : swarm.from_s;
    this.swarm = swarm;
    this.asked = "";
    if (!isSame) {
      this.history = new History(swarm);
      this.player = new Player(swarm, this.history, (message) => this.connection.send(message));
      this.selected = new Set();
      this.events.reset();
      this.table.reset();
      this.map.reset(swarm);
    }
    this.history.swarm = swarm;
    this.player.swarm = swarm;
    document.title = `${swarm.title} · Skein`;
    setText(byId("title"), swarm.name);
    byId("title").title = swarm.title;
    const source = byId("source");
    show(source, true);
    setText(source, swarm.isLive ? "live" : "recording");
    show(byId("orders-button"), swarm.hasOrders);
    this.player.start(resume_s);
    this.askField();
  }

  show(snapshot) {
    const crowd = this.crowd;
    this.crowd = null;
    this.history.add(snapshot, crowd);
  }

  /** What the parts of the page draw; `null` before the first picture. */
  scene() {
    const frame = this.player?.frame;
    if (!frame) return null;
    const { swarm, history, player, selected, events } = this;
    if (this.analysed !== frame) {
      this.analysed = frame;
      this.reception = analyse(frame);
    }
    return { frame, swarm, history, player, selected, events, reception: this.reception };
  }

  drawMap() {
    const now = performance.now();
    const isReplaying = this.player?.tick(Math.min(0.25, (now - (this.drawn_ms ?? now)) / 1000)) ?? false;
    this.drawn_ms = now;
    const scene = this.scene() ?? { frame: null, swarm: this.swarm };
    const isMoving = this.map.draw(scene);
    if (this.swarm?.isLarge) this.askDetails();
    if (isReplaying) this.schedule.request();
    return isMoving || isReplaying;
  }

  drawReception(scene) {
    const { swarm, frame, reception } = scene;
    const isWhole = frame.isUnknown || frame.members.length === swarm.vehicles.length;
    const found = isWhole ? describe(reception, frame, swarm) : { level: "none", text: partText(frame) };
    // An overview without details needs no room for them.
    document.body.classList.toggle("overview", swarm.isLarge && frame.members.length === 0);
    const text = byId("links-text");
    setText(text, found.text);
    text.dataset.level = found.level;
    this.matrix.draw(scene);
  }

  /** Selects vehicles; `isAdding` adds them to the selection or takes them out of it. */
  choose(indices, isAdding) {
    const isSame = indices.length === this.selected.size && indices.every((index) => this.selected.has(index));
    if (!isAdding) {
      this.selected = new Set(isSame ? [] : indices);
    } else {
      for (const index of indices) if (!this.selected.delete(index)) this.selected.add(index);
    }
    this.askField();
    this.schedule.request(true);
  }

  selectNext(places) {
    if (!this.swarm) return;
    const all = this.swarm.vehicles.length;
    const present = this.selected.size ? [...this.selected].at(-1) : places > 0 ? -1 : all;
    this.choose([(present + places + all) % all], false);
  }

  /** Asks for the field of the selected vehicle. */
  askField() {
    const only = this.selected.size === 1 ? this.swarm.ids[[...this.selected][0]] : null;
    this.connection?.send({ type: "field", vehicle: only });
  }

  /** Asks for details of the selected vehicles of a large swarm, or of those in view. */
  askDetails() {
    const wanted = this.selected.size ? [...this.selected] : (this.map.visible(MOST_DETAILS) ?? []);
    const ids = wanted.slice(0, MOST_DETAILS).map((index) => this.swarm.ids[index]);
    const asked = ids.join();
    if (asked === this.asked) return;
    this.asked = asked;
    this.connection.send({ type: "detail", vehicles: ids });
    if (!this.swarm.isLive && !this.player.isPlaying) this.player.start(this.player.position);
  }

  toggleMatrix() {
    document.body.classList.toggle("matrix");
    this.schedule.request(true);
  }

  control(act) {
    if (!this.player) return;
    act(this.player);
    this.schedule.request(true);
  }
}

/** What the links of a part of a large swarm are of. */
function partText(frame) {
  const vehicles = frame.members.length;
  if (vehicles === 0) return "zoom in to see links";
  return frame.link.some((link) => link !== 0) ? `of the ${vehicles} vehicles in view` : "no links of these vehicles are known";
}

new Page().schedule.request(true);
