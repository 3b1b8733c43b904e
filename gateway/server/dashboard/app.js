/** The dashboard: one connection, and the parts of the page that live on it. */

import { Card } from "./cards.js";
import { Chart } from "./charts.js";
import { connect } from "./client.js";
import { lay, sayNone } from "./deck.js";
import { el, mark, write } from "./dom.js";
import { enter, knock, leave } from "./entrance.js";
import { EventLog } from "./events.js";
import { RawFields } from "./fields.js";
import { clock } from "./format.js";
import { Robot, exact } from "./store.js";
import { themes } from "./themes.js";

const JOINTS_HZ = 30;
const TCP_HZ = 10;
const HISTORY = 500;
const MAX_GLOBS = 250;
const MAX_CHARTS = 6;
const TICK_MS = 1000;
const ROBOTS_EVERY_MS = 10_000;
const SETTLE_MS = 120;
const STATES = ["link", "status", "safety", "link_stats"];
const EDGES = ["events", "commands"];

const $ = (id) => document.getElementById(id);

class Page {
  constructor(token) {
    this.token = token;
    const address = new URL("ws", document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    address.search = address.hash = "";
    this.gateway = connect(address, { token });
    this.robots = new Map();
    this.renewed = new Set(); // names of robots whose entry in the configuration has changed
    this.cards = new Map();
    this.charts = [];
    this.visible = new Set();
    this.lastLive = null;
    this.world = { live: false, now: () => this.gateway.now() };
    this.events = new EventLog({
      robot: $("event-robot"),
      kind: $("event-kind"),
      text: $("event-text"),
      rows: $("event-rows"),
      empty: $("event-empty"),
      count: $("event-count"),
      said: $("said"),
    });
    this.fields = new RawFields(this.gateway, this.robots, {
      section: $("fields"),
      robot: $("field-robot"),
      text: $("field-text"),
      rows: $("field-rows"),
      empty: $("field-empty"),
      count: $("field-count"),
    });
    this.watch = new IntersectionObserver((entries) => this.see(entries), { rootMargin: "150px" });
    this.gateway.onstate = (state, reason) => this.turn(state, reason);
    this.gateway.onerror = (error) => this.complain(error);
    $("add-chart").addEventListener("click", () => this.addChart());
    document.addEventListener("visibilitychange", () => this.wake());
    window.addEventListener("online", () => this.gateway.retry());
    setInterval(() => this.tick(), TICK_MS);
    $("forget").hidden = token === null;
    $("forget").addEventListener("click", () => leave());
    this.turn(this.gateway.state, null);
  }

  /** The connection has come or gone: without it everything on the page is old. */
  turn(state, reason) {
    const live = state === "live";
    if (this.world.live && !live) {
      this.lastLive = this.gateway.now() * 1000;
      for (const chart of this.charts) chart.cut();
    }
    this.world.live = live;
    document.body.classList.toggle("is-old", !live);
    write($("connection"), live ? "Live" : this.lastLive === null && !reason ? "Connecting" : "Disconnected");
    mark($("connection"), "data-tone", live ? "good" : this.lastLive === null && !reason ? "unknown" : "bad");
    this.warn(live ? null : reason);
    this.summarise();
    for (const card of this.cards.values()) card.changed();
    this.fields.wake();
    if (live) this.begin();
    else if (state === "lost" && this.before === "connecting") this.knock();
    this.before = state;
  }

  /** A handshake has failed: perhaps because the gateway asks for a token now, or for another one. */
  async knock() {
    if (this.knocking) return;
    this.knocking = true;
    const found = await knock(this.token);
    this.knocking = false;
    if (found === "refused") leave({ withdrawn: this.token !== null });
  }

  warn(reason) {
    const old = this.lastLive === null ? "" : ` Everything below is old: it was last live at ${clock(this.lastLive)}.`;
    write($("banner"), reason ? `No connection to the gateway: ${reason}.${old} Trying again by itself.` : "");
    $("banner").hidden = !reason;
  }

  complain(error) {
    if (error.code === "UNKNOWN_TOPIC") return this.lookAgain(); // the gateway has other robots than this page knows of
    write($("banner"), `The gateway refused a request of this page: ${error.message}`);
    $("banner").hidden = false;
  }

  async begin() {
    write($("version"), this.gateway.welcome.gateway);
    await this.loadRobots();
    if (this.robots.size && !this.charts.length && !this.begun) this.addChart();
    this.begun ||= this.robots.size > 0;
  }

  /** Be subscribed to what the robots have, and a token may see. */
  subscribe(fresh) {
    const onSample = (sample) => this.take(sample);
    this.states = this.keep(this.states, STATES, { onSample }, fresh);
    this.edges = this.keep(
      this.edges,
      EDGES,
      {
        onEvent: (event) => this.takeEvent(event),
        onMissed: (missed) => missed.events !== 0 && this.events.addMissed(missed.events),
        onTopics: (_, lastEvents) => this.loadHistory(lastEvents),
      },
      fresh,
    );
  }

  keep(subscription, groups, options, fresh) {
    const robots = [...this.robots.values()];
    const topics = groups.filter((group) => robots.some((robot) => robot.info.groups.includes(group))).map((group) => `*/${group}`);
    if (!topics.length) {
      subscription?.close();
      return null;
    }
    if (!subscription) return this.gateway.subscribe(topics, options);
    if (fresh || topics.join() !== subscription.topics.join()) subscription.update(topics); // its answer brings what they say now
    return subscription;
  }

  takeEvent(event) {
    this.events.add(event);
    if (!event.kind.startsWith("robot.")) return; // it was added to the configuration, changed, or removed
    if (event.kind === "robot.changed") this.renewed.add(event.robot);
    this.lookAgain();
  }

  lookAgain() {
    clearTimeout(this.again);
    this.again = setTimeout(() => this.world.live && this.begin(), SETTLE_MS);
  }

  /** Ask which robots there are: it may be others after a reload or a new start of the gateway. */
  async loadRobots() {
    clearTimeout(this.robotsTimer);
    try {
      const infos = await this.gateway.robots();
      const known = JSON.stringify([...this.robots.values()].map(({ info }) => kind(info)));
      if (this.renewed.size || JSON.stringify(infos.map(kind)) !== known) this.rebuild(infos);
    } catch (error) {
      if (error.code !== "LOST" && error.code !== "CLOSED") this.complain(error);
      return;
    }
    if (!this.robots.size) sayNone($("cards"), this.token !== null);
    this.summarise();
    clearTimeout(this.robotsTimer);
    this.robotsTimer = setTimeout(() => this.world.live && this.begin(), ROBOTS_EVERY_MS);
  }

  /** Take other robots; the cards of those that are the same live on. */
  rebuild(infos) {
    const before = new Map(this.robots);
    const cards = new Map(this.cards);
    this.robots.clear();
    this.cards.clear();
    const fresh = [];
    for (const info of infos) {
      const known = before.get(info.name);
      const same = known && !this.renewed.has(info.name) && JSON.stringify(kind(known.info)) === JSON.stringify(kind(info));
      const robot = same ? known : new Robot(info);
      this.robots.set(info.name, robot);
      this.cards.set(info.name, same ? cards.get(info.name) : new Card(robot, this.world));
      if (!same) fresh.push(robot);
    }
    this.renewed.clear();
    lay($("cards"), cards, this.cards, this.watch);
    for (const name of cards.keys()) if (this.cards.get(name) !== cards.get(name)) this.visible.delete(name);
    const names = new Set(fresh.map((robot) => robot.name));
    this.events.offerRobots([...this.robots.keys()]);
    this.fields.offer(names);
    for (const chart of this.charts) chart.offer(undefined, names);
    this.subscribe(before.size > 0 && fresh.length > 0);
    this.listen();
    for (const robot of fresh) this.learn(robot);
  }

  /** Ask what a robot can never tell: it is not merely unknown. */
  async learn(robot) {
    for (const group of ["status", "safety", "joints"]) {
      if (!robot.info.groups.includes(group)) continue;
      try {
        const { never } = await this.gateway.describe(`${robot.name}/${group}`);
        for (const key of never ?? []) robot.never.add(`${group}.${key}`);
      } catch {
        return; // without an answer a dash stays "unknown"
      }
    }
    this.cards.get(robot.name)?.changed();
  }

  async loadHistory(lastEvents) {
    if (this.hasHistory) return; // after a reconnect the subscription reads on by itself
    this.hasHistory = true;
    const since = lastEvents.map((name) => {
      const [, boot, seq] = name.match(/^(.*):(\d+)$/);
      return `${boot}:${Math.max(0, Number(seq) - HISTORY)}`;
    });
    try {
      this.events.addHistory(await this.gateway.events({ since, limit: 10_000, topics: ["*/events", "*/commands"] }));
    } catch (error) {
      this.hasHistory = false;
      if (error.code !== "LOST" && error.code !== "CLOSED") this.complain(error);
    }
  }

  take(sample) {
    const slash = sample.topic.lastIndexOf("/");
    const name = sample.topic.slice(0, slash);
    const group = sample.topic.slice(slash + 1);
    const robot = this.robots.get(name);
    if (!robot) return;
    robot.take(group, sample);
    this.cards.get(name).changed();
    if (group === "link" || group === "status" || group === "safety") this.summarise();
  }

  see(entries) {
    for (const entry of entries) {
      const { robot } = entry.target.dataset;
      if (entry.isIntersecting) this.visible.add(robot);
      else this.visible.delete(robot);
    }
    clearTimeout(this.settle);
    this.settle = setTimeout(() => this.listen(), SETTLE_MS);
  }

  /** Be subscribed to the fast topics of the cards that can be seen, and to no others. */
  listen() {
    this.joints = this.follow(this.joints, "joints", ["position"], JOINTS_HZ);
    this.tcp = this.follow(this.tcp, "tcp", ["pose", "substituted"], TCP_HZ);
  }

  follow(subscription, group, fields, rateHz) {
    const names = document.hidden ? [] : [...this.robots.values()].filter((robot) => this.visible.has(robot.name) && robot.info.groups.includes(group));
    const topics = names.length > MAX_GLOBS ? [`*/${group}`] : names.map((robot) => exact(`${robot.name}/${group}`)).sort();
    if (!topics.length) {
      subscription?.close();
      return null;
    }
    if (!subscription) return this.gateway.subscribe(topics, { fields, rateHz, onSample: (sample) => this.take(sample) });
    if (topics.join() !== subscription.topics.join()) subscription.update(topics);
    return subscription;
  }

  wake() {
    this.listen();
    this.fields.wake();
    for (const chart of this.charts) chart.wake();
    if (!document.hidden) this.gateway.retry();
  }

  tick() {
    if (document.hidden) return;
    for (const card of this.cards.values()) card.tick();
  }

  summarise() {
    const robots = [...this.robots.values()];
    if (!robots.length) {
      this.summarised = null;
      $("summary").replaceChildren();
      return;
    }
    const online = robots.filter((robot) => robot.online).length;
    const all = `${robots.length} ${robots.length === 1 ? "robot" : "robots"} · ${online} online`;
    const told = robots
      .map((robot) => [robot.name, robot.attention()])
      .filter(([, found]) => found.length)
      .map(([name, found]) => [name, `${name}: ${found.map(([words]) => words).join(", ")}`, found[0][1]]);
    const text = JSON.stringify([all, told, this.world.live]);
    if (this.summarised === text) return;
    this.summarised = text;
    const links = told.map(([name, words, tone]) => {
      const show = (event) => {
        event.preventDefault();
        this.cards.get(name)?.root.scrollIntoView({ block: "start" });
        this.cards.get(name)?.root.focus({ preventScroll: true });
      };
      return el("a", { href: "#robots", class: "alert", "data-tone": this.world.live ? tone : "unknown", text: words, on: { click: show } });
    });
    $("summary").replaceChildren(`${this.world.live ? "" : "When last seen: "}${all}`, ...links.flatMap((link) => [" · ", link]));
  }

  addChart() {
    if (this.charts.length >= MAX_CHARTS) return;
    const robot = [...this.robots.keys()][this.charts.length % Math.max(1, this.robots.size)];
    const remove = (chart) => {
      chart.close();
      this.charts = this.charts.filter((one) => one !== chart);
      $("add-chart").disabled = false;
      $("add-chart").focus();
    };
    const chart = new Chart(this.gateway, this.robots, { robot, group: "joints", field: "position" }, remove);
    this.charts.push(chart);
    $("chart-list").append(chart.root);
    $("add-chart").disabled = this.charts.length >= MAX_CHARTS;
  }
}

const kind = ({ name, vendor, protocol, groups }) => [name, vendor, protocol, groups];

let page = null;
themes($("theme"), () => page?.charts.forEach((chart) => chart.recolour()));
page = new Page(
  await enter({
    section: $("entrance"),
    form: $("token-form"),
    token: $("token"),
    keep: $("token-keep"),
    error: $("token-error"),
    chip: $("connection"),
  }),
);
