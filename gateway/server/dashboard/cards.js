/** The cell at a glance: a card a robot. */

import { el, mark, painter, shape, write } from "./dom.js";
import { DASH, WORDS, clock, duration, fault, fullTime, number, quality, rotation, state } from "./format.js";

const TEXT_EVERY_MS = 100; // numbers that change faster cannot be read
const HALF_TURN = Math.PI;
const QUARTER_TURN = Math.PI / 2;
const DEGREES = 180 / Math.PI;
const AXES = [
  ["X", "mm"],
  ["Y", "mm"],
  ["Z", "mm"],
  ["RX", "°"],
  ["RY", "°"],
  ["RZ", "°"],
];
const STATES = [
  ["mode", "Mode", "status.operating_mode"],
  ["power", "Power", "status.power"],
  ["motion", "Motion", "status.motion"],
  ["speed", "Speed", "status.speed_override"],
  ["safety", "Safety", "safety.state"],
  ["estop", "E-stop", "status.e_stopped"],
  ["program", "Program", "status.program.state"],
];

/** One robot's card; `root` goes into the page. */
export class Card {
  constructor(robot, world) {
    this.robot = robot;
    this._world = world; // {live, now()}
    this._rows = [];
    this._seen = []; // [lowest, highest] of each joint, rad
    this._wroteAt = -Infinity;
    this._paint = (now) => this.paint(now);
    this.root = this._build();
    this.changed();
  }

  /** Something of it has changed. */
  changed() {
    painter.soon(this._paint);
  }

  /** The seconds go on where an age is shown. */
  tick() {
    this._writeLink();
  }

  paint(now) {
    this._moveBars();
    if (now - this._wroteAt < TEXT_EVERY_MS) {
      painter.soon(this._paint);
      return;
    }
    this._wroteAt = now;
    this._writeLink();
    this._writeStates();
    this._writeFaults();
    this._writeJoints();
    this._writePose();
  }

  _build() {
    const id = `robot-${Card.count++}`;
    const { info } = this.robot;
    this._chip = el("span", { class: "chip", "data-part": "link" });
    this._origin = el("span", { class: "tag", hidden: true });
    this._link = el("p", { class: "link-line" });
    this._notes = el("ul", { class: "notes", hidden: true });
    this._states = Object.fromEntries(STATES.map(([key]) => [key, el("dd", { "data-part": key })]));
    const states = STATES.map(([key, label]) => el("div", { class: `pair ${key}` }, el("dt", { text: label }), this._states[key]));
    this._faults = el("ul", { class: "faults", hidden: true, "aria-label": `Faults of ${info.name}` });
    this._jointsWord = el("span", { class: "tag", hidden: true });
    this._poseWord = el("span", { class: "tag", hidden: true });
    this._scale = el("span", { class: "faint" });
    this._joints = el("tbody");
    this._pose = AXES.map(() => el("td"));
    const cell = ([axis, unit], n) => [el("th", { scope: "row", text: axis }), this._pose[n], el("td", { class: "unit", text: unit })];
    const lines = [0, 1, 2].map((n) => el("tr", {}, ...cell(AXES[n], n), ...cell(AXES[n + 3], n + 3)));
    return el(
      "article",
      { class: "card", id: `card-${info.name}`, tabindex: "-1", "aria-labelledby": id, "data-robot": info.name },
      el(
        "header",
        {},
        el("div", {}, el("h3", { id, text: info.name }), el("span", { class: "faint", text: `${info.vendor} · ${info.protocol}` })),
        el("div", { class: "chips" }, this._origin, this._chip),
      ),
      this._link,
      this._notes,
      el("dl", { class: "states" }, ...states),
      this._faults,
      el("h4", {}, "Joints ", this._scale, this._jointsWord),
      el(
        "table",
        { class: "joints" },
        el("caption", { class: "sr", text: `Measured joint positions of ${info.name} in degrees` }),
        this._joints,
      ),
      el("h4", {}, "Tool centre point ", this._poseWord),
      el("table", { class: "pose" }, el("caption", { class: "sr", text: `Pose of the tool centre point of ${info.name}, in the base` }), el("tbody", {}, ...lines)),
    );
  }

  _writeLink() {
    const { robot } = this;
    const link = robot.data("link");
    const stats = robot.data("link_stats");
    const { live } = this._world;
    const [words, tone] = state(WORDS.link, link.state);
    write(this._chip, live ? words : `Was ${words.toLowerCase()}`);
    mark(this._chip, "data-tone", live ? tone : "unknown");
    mark(this.root, "data-old", live && robot.online ? null : "true");
    const worst = robot.attention()[0];
    mark(this.root, "data-tone", worst ? worst[1] : null);
    const origin = Object.values(robot.samples).find((sample) => sample.origin && sample.origin !== "live")?.origin;
    write(this._origin, origin === "sim" ? "Simulated" : origin === "replay" ? "Replay" : "");
    this._origin.hidden = !origin;
    write(this._link, robot.online ? this._onlineLine(link, stats) : this._offlineLine(link));
    this._writeNotes(link.notes ?? []);
  }

  _onlineLine(link, stats) {
    const rate = typeof link.reached_hz === "number" ? `${plainRate(link.reached_hz)} Hz` : "rate not known yet";
    const age = typeof stats.age === "number" ? `last frame ${ageWords(stats.age)}` : null;
    const rejects = Object.values(stats.rejects ?? {}).reduce((sum, one) => sum + one, 0);
    const parts = [rate, age, rejects ? `${rejects} rejected` : null];
    if (link.since) parts.push(`online for ${duration(this._world.now() / 1000 - link.since / 1e6)}`);
    return joined(parts);
  }

  _offlineLine(link) {
    const now = this._world.now() / 1000;
    const last = this.robot.lastFrame;
    const next = link.next_attempt ? link.next_attempt / 1e6 - now : null;
    const error = link.last_error && link.last_error !== link.reason ? `Before: ${link.last_error}` : null;
    return joined([
      link.reason ?? "No reason is known",
      error,
      link.since ? `not online for ${duration(now - link.since / 1e6)}` : null,
      last ? `last frame at ${clock(last)}` : "no frame yet",
      link.attempts ? `${link.attempts} ${link.attempts === 1 ? "attempt" : "attempts"}` : null,
      next !== null && next > 0 && this._world.live ? `next in ${Math.ceil(next)} s` : null,
    ]);
  }

  _writeNotes(notes) {
    const text = notes.join("\n");
    if (this._notes.told === text) return;
    this._notes.told = text;
    this._notes.replaceChildren(...notes.map((note) => el("li", { text: note })));
    this._notes.hidden = !notes.length;
  }

  _writeStates() {
    const status = this.robot.data("status");
    const safety = this.robot.data("safety");
    const program = status.program ?? {};
    this._word("mode", state(WORDS.mode, status.operating_mode));
    this._word("power", state(WORDS.power, status.power));
    this._word("motion", state(WORDS.motion, status.motion));
    const [safe, tone] = state(WORDS.safety, safety.state);
    const collides = safety.collision || safety.self_collision;
    this._word("safety", collides ? [safe === DASH ? "Collision" : `${safe}, collision`, "bad"] : [safe, tone]);
    this._word("estop", { true: ["Pressed", "bad"], false: ["Released", "good"] }[status.e_stopped] ?? [DASH, "unknown"]);
    const speed = typeof status.speed_override === "number";
    this._word("speed", speed ? [`${number(status.speed_override * 100, 0)} %`, "idle"] : [DASH, "unknown"]);
    const [ran, how] = state(WORDS.program, program.state);
    const line = Number.isInteger(program.line) ? `line ${program.line}${program.total_lines ? ` of ${program.total_lines}` : ""}` : null;
    this._word("program", [[ran, program.name, line].filter(Boolean).join(" · "), how]);
  }

  _word(key, [text, tone]) {
    const node = this._states[key];
    const never = this.robot.never.has(STATES.find(([one]) => one === key)[2]);
    write(node, text === DASH ? `${DASH} ${never && this.robot.online ? "not told" : "unknown"}` : text);
    mark(node, "data-tone", tone);
    mark(node, "title", text === DASH && never ? "This robot's protocol cannot tell" : null);
  }

  _writeFaults() {
    const faults = this.robot.data("status").faults ?? [];
    const told = JSON.stringify(faults);
    if (this._faults.told === told) return;
    this._faults.told = told;
    this._faults.replaceChildren(...faults.map(faultItem));
    this._faults.hidden = !faults.length;
  }

  _moveBars() {
    const { position } = this.robot.data("joints");
    if (!Array.isArray(position)) {
      for (const row of this._rows) mark(row.bar, "hidden", "");
      return;
    }
    this._makeRows(position.length);
    let largest = HALF_TURN;
    position.forEach((value, n) => {
      if (typeof value !== "number") return;
      const seen = (this._seen[n] ??= [value, value]);
      if (value < seen[0]) seen[0] = value;
      if (value > seen[1]) seen[1] = value;
    });
    for (const seen of this._seen) if (seen) largest = Math.max(largest, -seen[0], seen[1]);
    const range = largest > HALF_TURN ? Math.ceil(largest / QUARTER_TURN) * QUARTER_TURN : HALF_TURN;
    write(this._scale, `±${Math.round(range * DEGREES)}°`);
    position.forEach((value, n) => {
      const row = this._rows[n];
      mark(row.bar, "hidden", typeof value === "number" ? null : "");
      if (typeof value !== "number") return;
      const [low, high] = this._seen[n];
      shape(row.bar, `scaleX(${(value / range).toFixed(4)})`);
      shape(row.band, `translateX(${(((low / range + 1) / 2) * 100).toFixed(2)}%) scaleX(${((high - low) / range / 2).toFixed(4)})`);
    });
  }

  _makeRows(count) {
    if (this._rows.length === count) return;
    this._rows = Array.from({ length: count }, (_, n) => {
      const row = { bar: el("i", { class: "bar" }), band: el("i", { class: "band" }), value: el("td", { class: "number" }) };
      const track = el("td", { class: "track-cell", "aria-hidden": "true" }, el("div", { class: "track" }, row.band, row.bar));
      row.line = el("tr", {}, el("th", { scope: "row", text: `J${n + 1}` }), track, row.value, el("td", { class: "unit", text: "°" }));
      return row;
    });
    this._joints.replaceChildren(...this._rows.map((row) => row.line));
  }

  _writeJoints() {
    const sample = this.robot.samples.joints;
    const position = sample?.data.position;
    if (!this._rows.length && !Array.isArray(position)) {
      const text = this.robot.never.has("joints.position") ? `${DASH} not told by this robot` : `${DASH} unknown`;
      if (!this._joints.firstChild) this._joints.append(el("tr", {}, el("td", { class: "unknown" })));
      write(this._joints.querySelector("td"), text);
    }
    this._rows.forEach((row, n) => {
      const value = Array.isArray(position) ? position[n] : null;
      write(row.value, number(typeof value === "number" ? value * DEGREES : null, 1));
    });
    this._qualify(this._jointsWord, sample);
  }

  _writePose() {
    const sample = this.robot.samples.tcp;
    const pose = sample?.data.pose;
    const place = pose?.position ?? [];
    const turn = rotation(pose?.orientation) ?? [];
    for (let n = 0; n < 3; n++) {
      write(this._pose[n], number(typeof place[n] === "number" ? place[n] * 1000 : null, 1));
      write(this._pose[n + 3], number(turn[n], 1));
    }
    this._qualify(this._poseWord, sample);
  }

  _qualify(node, sample) {
    const word = this._world.live ? quality(sample?.q) : "old";
    const since = sample?.t_last ? ` since ${clock(sample.t_last)}` : "";
    write(node, word ? word + (word === "old" ? "" : since) : "");
    mark(node, "data-q", sample?.q ?? null);
    node.hidden = !word;
  }
}
Card.count = 1;

function faultItem(one) {
  const item = el("li", {}, el("strong", { text: fault(one) }));
  const about = [one.severity?.toLowerCase(), one.since ? `since ${clock(one.since)}` : null].filter(Boolean).join(", ");
  if (about) item.append(el("span", { class: "faint", text: ` ${about}`, title: one.since ? fullTime(one.since) : null }));
  if (one.remedy) item.append(el("div", { class: "remedy", text: `Remedy: ${one.remedy}` }));
  return item;
}

/** Parts of a line; it is broken between them only, where they are short. */
function joined(parts) {
  const short = (part) => (part.length < 40 ? part.replaceAll(" ", "\u00a0") : part);
  return parts.filter(Boolean).map(short).join(" · ");
}

function plainRate(hz) {
  return number(hz, Number.isInteger(hz) || hz >= 100 ? 0 : 1);
}

function ageWords(seconds) {
  return seconds < 1 ? `${Math.round(seconds * 1000)} ms ago` : `${duration(seconds)} ago`;
}
