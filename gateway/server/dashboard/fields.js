/** The vendor's raw fields of one robot, searchable, under the manual's names and in its units. */

import { el, fill, mark, painter, write } from "./dom.js";
import { quality, raw } from "./format.js";
import { exact } from "./store.js";

const RATE_HZ = 5;

export class RawFields {
  constructor(gateway, robots, page) {
    this._gateway = gateway;
    this._robots = robots;
    this._page = page; // the elements: section, robot, text, rows, empty, count
    this._rows = [];
    this._visible = false;
    this._asks = 0;
    this._paint = () => this._write();
    page.robot.addEventListener("input", () => this._choose());
    page.text.addEventListener("input", () => this._filter());
    new IntersectionObserver(([entry]) => this._see(entry.isIntersecting), { rootMargin: "100px" }).observe(page.section);
  }

  /** The robots that may be chosen; `fresh`: names of those that are new or others than before. */
  offer(fresh = new Set()) {
    if (fresh.has(this._shown)) this._shown = null;
    const names = [...this._robots.values()].filter((robot) => robot.info.groups.includes("vendor")).map((robot) => robot.name);
    fill(this._page.robot, names.map((name) => [name, name]));
    this._choose();
  }

  /** The page is hidden, or shown again; or the connection has come or gone. */
  wake() {
    this._listen();
    painter.soon(this._paint);
  }

  async _choose() {
    const robot = this._page.robot.value;
    if (!robot) return this._clear();
    if (robot === this._shown) return;
    const turn = ++this._asks;
    try {
      const description = await this._gateway.describe(`${robot}/vendor`);
      if (turn !== this._asks) return;
      this._shown = robot;
      this._sample = null;
      this._rows = [];
      for (const [name, schema] of Object.entries(description.schema.properties ?? {})) this._addRows(name, schema);
      this._page.rows.replaceChildren(...this._rows.map((row) => row.line));
      this._filter();
      this._listen();
    } catch (error) {
      if (turn === this._asks && error.code !== "LOST" && error.code !== "CLOSED") this._tell(error.message);
    }
  }

  /** No robot is left to show. */
  _clear() {
    this._asks++;
    this._shown = this._sample = this._counted = null;
    this._rows = [];
    this._page.rows.replaceChildren();
    this._listen();
    this._tell("No robot has raw fields.");
    painter.soon(this._paint);
  }

  _addRows(name, schema) {
    this._addRow([name], schema);
    for (const [flag, below] of Object.entries(schema.properties ?? {})) {
      if (flag !== "raw") this._addRow([name, flag], below);
    }
  }

  _addRow(path, schema) {
    const meaning = schema.description ?? "";
    const unit = schema.unit ?? "";
    const value = el("td", { class: "value" });
    const head = el("th", { scope: "row", class: path.length > 1 ? "flag" : null }, el("code", { text: path.join(".") }));
    if (meaning) head.append(el("span", { class: "meaning", text: meaning }));
    const line = el("tr", {}, head, value, el("td", { class: "unit", text: unit }));
    const row = { path, words: `${path.join(".")} ${unit} ${meaning}`.toLowerCase(), line, value };
    this._rows.push(row);
    return row;
  }

  _filter() {
    const words = this._page.text.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const row of this._rows) {
      row.shown = words.every((word) => row.words.includes(word));
      row.line.hidden = !row.shown;
      if (row.shown) count++;
    }
    this._tell(this._rows.length ? (count ? null : "No field matches.") : "This robot describes no raw fields.");
    this._counted = `${count} of ${this._rows.length} fields`;
    painter.soon(this._paint);
  }

  _tell(text) {
    write(this._page.empty, text ?? "");
    this._page.empty.hidden = !text;
  }

  _see(visible) {
    this._visible = visible;
    this._listen();
  }

  _listen() {
    const wanted = this._visible && !document.hidden && this._shown ? `${this._shown}/vendor` : null;
    if (wanted === this._heard) return;
    this._heard = wanted;
    if (wanted === null) {
      this._subscription?.close();
      this._subscription = null;
      return;
    }
    const options = { rateHz: RATE_HZ, onSample: (sample) => this._take(sample) };
    if (this._subscription) this._subscription.update([exact(wanted)], options);
    else this._subscription = this._gateway.subscribe([exact(wanted)], options);
  }

  _take(sample) {
    if (sample.topic !== this._heard) return;
    this._sample = { ...sample, data: { ...this._sample?.data, ...sample.data } };
    painter.soon(this._paint);
  }

  _write() {
    const { _sample: sample } = this;
    const live = this._gateway.state === "live";
    const word = live ? quality(sample?.q) : "old";
    write(this._page.count, [this._counted, sample && word ? word : null].filter(Boolean).join(" · "));
    mark(this._page.section, "data-old", sample && live && sample.q !== "STALE" && sample.q !== "DISCONNECTED" ? null : "true");
    if (!sample) return;
    const known = new Set(this._rows.map((row) => row.path[0]));
    const further = Object.keys(sample.data).filter((name) => !known.has(name));
    if (further.length) {
      this._page.rows.append(...further.map((name) => this._addRow([name], {}).line));
      this._filter();
    }
    for (const row of this._rows) {
      if (row.shown) write(row.value, raw(valueOf(sample.data, row)));
    }
  }
}

/** A word with flags shows its raw bits; its flags have rows of their own. */
function valueOf(data, { path: [name, flag] }) {
  const value = data[name];
  if (flag !== undefined) return value?.[flag];
  return value !== null && typeof value === "object" && "raw" in value ? value.raw : value;
}
