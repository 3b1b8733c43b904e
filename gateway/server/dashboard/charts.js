/** Live strip charts: each of a topic and a field that the operator chooses. */

import { el, fill, mark, painter, write } from "./dom.js";
import { clock, number } from "./format.js";
import { plot, timeScale } from "./plot.js";
import { Series, WINDOW_S, at, lines, numericFields } from "./series.js";
import { exact } from "./store.js";

const RATE_HZ = 30;
const FRAME_MS = 66; // 60 s move some 10 pixels a second: more pictures would show nothing new
const NEAR_MS = 2000;
const LINES = 8;
const SHOWN_GROUPS = ["joints", "tcp", "wrench", "controller", "vendor", "link_stats", "status"];

/** One chart; `root` goes into the page. */
export class Chart {
  constructor(gateway, robots, choice, onRemove) {
    this._gateway = gateway;
    this._robots = robots; // name → Robot
    this._fields = [];
    this._series = new Series();
    this._names = [];
    this._shown = [];
    this._frozen = null; // {series, end} while paused
    this._cursor = null; // ms before the end
    this._visible = false;
    this._drewAt = -Infinity;
    this._asks = 0;
    this._draw = (now) => this._paint(now);
    this._build(onRemove);
    this._watch = new IntersectionObserver(([entry]) => this._see(entry.isIntersecting), { rootMargin: "100px" });
    this._watch.observe(this.root);
    this._resized = new ResizeObserver(() => this._redraw());
    this._resized.observe(this._canvas);
    this.offer(choice);
  }

  /** The robots have changed: offer what there is; `fresh`: names of those that are new or others than before. */
  offer(choice = this._choice(), fresh = new Set()) {
    if (fresh.has(this._topic?.slice(0, this._topic.lastIndexOf("/")))) this._topic = this._drawn = null;
    fill(this._robot, [...this._robots.keys()].map((name) => [name, name]), choice.robot);
    const groups = this._robots.get(this._robot.value)?.info.groups ?? [];
    fill(this._group, SHOWN_GROUPS.filter((name) => groups.includes(name)).map((name) => [name, name]), choice.group);
    this._loadFields(choice.field);
  }

  /** The connection is lost: what follows is not known. */
  cut() {
    this._series.gap(this._gateway.now());
  }

  /** The page is hidden, or shown again. */
  wake() {
    this._listen();
  }

  /** The theme has changed. */
  recolour() {
    this._colours = null;
    this._redraw();
  }

  close() {
    this._watch.disconnect();
    this._resized.disconnect();
    this._subscription?.close();
    this._closed = true;
    this.root.remove();
  }

  _choice() {
    return { robot: this._robot.value, group: this._group.value, field: this._field.value };
  }

  _build(onRemove) {
    const number = Chart.count++;
    const changed = () => this.offer();
    this._robot = el("select", { on: { change: changed } });
    this._group = el("select", { on: { change: changed } });
    this._field = el("select", { on: { change: () => this._start() } });
    this._pause = el("button", { type: "button", "aria-pressed": "false", text: "Pause", on: { click: () => this._toggle() } });
    const remove = el("button", { type: "button", "aria-label": `Remove chart ${number}`, text: "Remove", on: { click: () => onRemove(this) } });
    this._canvas = el("canvas", {
      tabindex: "0",
      role: "slider",
      "aria-label": `Time cursor of chart ${number}: left and right read values, Escape lets go`,
      "aria-valuemin": String(-WINDOW_S),
      "aria-valuemax": "0",
      "aria-valuenow": "0",
      "aria-valuetext": "now",
      on: {
        pointermove: (event) => this._point(event.offsetX),
        pointerdown: (event) => this._point(event.offsetX),
        pointerleave: () => this._release(),
        blur: () => this._release(),
        keydown: (event) => this._key(event),
      },
    });
    this._legend = el("div", { class: "legend", role: "group", "aria-label": `Lines of chart ${number}` });
    this._readout = el("p", { class: "readout faint" });
    this._message = el("p", { class: "chart-message", hidden: true });
    this.root = el(
      "figure",
      { class: "chart", "aria-label": `Chart ${number}` },
      el(
        "div",
        { class: "controls" },
        el("label", {}, "Robot ", this._robot),
        el("label", {}, "Topic ", this._group),
        el("label", { class: "grow" }, "Field ", this._field),
        el("div", { class: "buttons" }, this._pause, remove),
      ),
      el("div", { class: "canvas-box" }, this._canvas, this._message),
      this._readout,
      this._legend,
    );
  }

  async _loadFields(wanted) {
    const topic = `${this._robot.value}/${this._group.value}`;
    if (!this._group.value) return this._say("This robot has nothing to draw");
    if (topic === this._topic && this._fields.length) return this._start(wanted);
    const turn = ++this._asks;
    try {
      const fields = numericFields(await this._gateway.describe(topic));
      if (turn !== this._asks || this._closed) return;
      this._topic = topic;
      this._fields = fields;
      const spoken = (field) => `${field.path}${field.unit && field.unit !== "1" ? ` (${lines(this._group.value, field).unit})` : ""}`;
      fill(this._field, fields.map((field) => [field.path, spoken(field)]), wanted);
      this._start();
    } catch (error) {
      if (turn === this._asks && error.code !== "LOST" && error.code !== "CLOSED") this._say(error.message);
    }
  }

  /** Show another field, from now on. */
  _start(wanted = this._field.value) {
    const field = this._fields.find((one) => one.path === wanted) ?? this._fields[0];
    if (!field) return this._say("This topic holds no numbers");
    const key = `${this._topic} ${field.path}`;
    this._field.value = field.path;
    if (key !== this._drawn) {
      this._drawn = key;
      this._chosen = { ...field, topic: this._topic, lines: lines(this._group.value, field) };
      this._series = new Series();
      this._names = [];
      this._shown = [];
      this._legend.replaceChildren();
      if (this._frozen) this._toggle();
      this._cursor = null;
      this._canvas.title = field.text;
      this._say("Waiting for values");
    }
    this._listen();
  }

  _see(visible) {
    this._visible = visible;
    this._listen();
  }

  /** Be subscribed while there is somebody to see it, and only then. */
  _listen() {
    if (!this._chosen || this._closed) return;
    const wanted = this._visible && !document.hidden ? `${this._chosen.topic} ${this._chosen.path}` : null;
    if (wanted === this._heard) return;
    this._heard = wanted;
    if (wanted === null) {
      this._subscription?.close();
      this._subscription = null;
      this.cut();
      return;
    }
    const { topic, path } = this._chosen;
    const options = { rateHz: RATE_HZ, fields: [path], onSample: (sample) => this._take(sample) };
    if (this._subscription) this._subscription.update([exact(topic)], options);
    else this._subscription = this._gateway.subscribe([exact(topic)], options);
    this._redraw();
  }

  _take(sample) {
    const { lines: shown, path, topic } = this._chosen;
    if (sample.topic !== topic) return;
    const value = at(sample.data, path);
    if (value === undefined) return; // of another subscription to the same topic
    const known = value !== null;
    if (known && !this._names.length) this._nameLines(shown.names(Array.isArray(value) ? value.length : 1, Array.isArray(value)));
    if (known) this._say(null);
    else if (!this._names.length) this._say(sample.q === "STALE" || sample.q === "DISCONNECTED" ? "No values: the link is down" : "The robot does not tell this value");
    if (known) this._series.add(sample.t / 1000, shown.values(value), sample.epoch);
    else this._series.gap(sample.t / 1000);
  }

  _nameLines(names) {
    this._names = names;
    this._shown = names.map((_, n) => n < LINES);
    this._values = names.map(() => el("span", { class: "number" }));
    this._legend.replaceChildren(
      ...names.map((name, n) => {
        const swatch = el("i", { class: `line-${n % LINES}`, "aria-hidden": "true" });
        const button = el("button", { type: "button", "aria-pressed": String(this._shown[n]) }, swatch, `${name} `, this._values[n]);
        button.addEventListener("click", () => {
          this._shown[n] = !this._shown[n];
          mark(button, "aria-pressed", String(this._shown[n]));
          this._redraw();
        });
        return button;
      }),
    );
  }

  _say(text) {
    write(this._message, text ?? "");
    this._message.hidden = !text;
  }

  _toggle() {
    this._frozen = this._frozen ? null : { series: this._series.copy(), end: this._gateway.now() };
    mark(this._pause, "aria-pressed", String(this._frozen !== null));
    write(this._pause, this._frozen ? "Resume" : "Pause");
    this._redraw();
  }

  _point(x) {
    const end = this._end();
    const t = timeScale(this._canvas.clientWidth, end).t(x);
    this._cursor = Math.min(WINDOW_S * 1000, Math.max(0, end - t));
    this._redraw();
  }

  _release() {
    this._cursor = null;
    mark(this._canvas, "aria-valuenow", "0");
    mark(this._canvas, "aria-valuetext", "now");
    this._redraw();
  }

  _key(event) {
    const step = { ArrowLeft: 500, ArrowRight: -500, PageUp: 5000, PageDown: -5000 }[event.key];
    if (event.key === "Escape") return this._release();
    if (step === undefined && event.key !== "Home" && event.key !== "End") return;
    event.preventDefault();
    const moved = event.key === "Home" ? WINDOW_S * 1000 : event.key === "End" ? 0 : (this._cursor ?? 0) + step;
    this._cursor = Math.min(WINDOW_S * 1000, Math.max(0, moved));
    this._spoken = true;
    this._redraw();
  }

  _end() {
    return this._frozen?.end ?? this._gateway.now();
  }

  _redraw() {
    this._drewAt = -Infinity;
    painter.soon(this._draw);
  }

  _paint(now) {
    if (this._closed || !this._visible) return;
    if (!this._frozen && !document.hidden) painter.soon(this._draw);
    if (now - this._drewAt < FRAME_MS) return;
    this._drewAt = now;
    const series = this._frozen?.series ?? this._series;
    const end = this._end();
    const cursor = this._cursor === null ? null : end - this._cursor;
    this._colours ??= colours(this.root);
    plot(this._canvas, { series, shown: this._shown, turns: this._chosen?.lines.turns, end, cursor, colours: this._colours });
    this._read(series, cursor);
  }

  _read(series, cursor) {
    const last = series.rows.length - 1;
    const n = cursor === null ? (series.rows[last] ? last : -1) : series.nearest(cursor, NEAR_MS);
    const row = series.rows[n];
    const unit = this._chosen?.lines.unit ?? "";
    this._values?.forEach((node, k) => write(node, number(row?.[k] ?? null, 2)));
    const when = n >= 0 ? clock(series.times[n] * 1000, true) : cursor === null ? "no value now" : `${clock(cursor * 1000, true)}: no value`;
    const state = this._frozen ? "Paused. " : "";
    write(this._readout, `${state}${cursor === null ? "Newest" : "At the cursor"}: ${when}${unit ? ` · in ${unit}` : ""}`);
    if (this._spoken) {
      this._spoken = false;
      const told = this._names.map((name, k) => (this._shown[k] ? `${name} ${number(row?.[k] ?? null, 2)}` : null)).filter(Boolean);
      mark(this._canvas, "aria-valuenow", String(-Math.round((this._cursor ?? 0) / 100) / 10));
      mark(this._canvas, "aria-valuetext", `${when}: ${told.join(", ")} ${unit}`);
    }
  }
}
Chart.count = 1;

function colours(node) {
  const style = getComputedStyle(node);
  const of = (name) => style.getPropertyValue(name).trim();
  return {
    text: of("--text"),
    faint: of("--faint"),
    grid: of("--line"),
    font: style.fontFamily,
    lines: Array.from({ length: LINES }, (_, n) => of(`--line-${n}`)),
  };
}
