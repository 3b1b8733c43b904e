/** The event log with its filter: the newest first. */

import { el, fill, mark, painter, write } from "./dom.js";
import { change, clock, fullTime, kindTone } from "./format.js";

const KEPT = 5000;
const SHOWN = 200;
const DRAW_EVERY_MS = 200;
const SAY_EVERY_MS = 1500;
const SAID = 3;

export class EventLog {
  constructor(page) {
    this._page = page; // the elements: robot, kind, text, rows, empty, count, said
    this._events = []; // the oldest first
    this._names = new Set();
    this._kinds = new Set();
    this._fresh = [];
    this._stale = true;
    this._drewAt = -Infinity;
    this._toSay = [];
    this._saidAt = -Infinity;
    this._draw = (now) => this._paint(now);
    for (const control of [page.robot, page.kind, page.text]) control.addEventListener("input", () => this._refilter());
    this._offerKinds();
    this.offerRobots([]);
  }

  /** The robots that may be chosen. */
  offerRobots(names) {
    fill(this._page.robot, [["", "all"], ...names.map((name) => [name, name])]);
  }

  /** Take events from before the page was opened. */
  addHistory(events) {
    const older = events.filter((event) => this._isNew(event));
    this._events = [...older, ...this._events].slice(-KEPT);
    this._refilter();
  }

  /** Take an event that has just happened. */
  add(event) {
    if (!this._isNew(event)) return;
    this._events.push(event);
    this._fresh.push(event);
    if (this._events.length > 2 * KEPT) this._forget();
    this._announce(event);
    painter.soon(this._draw);
  }

  /** Events are gone that nobody here has seen. */
  addMissed(count) {
    const text = count === null ? "Events are missing: their number is not known" : `${count} events are missing`;
    this.add({ name: `missed ${Math.random()}`, robot: "", t: Date.now() * 1000, kind: "missed", from: null, to: text, tone: "bad" });
  }

  _isNew(event) {
    if (this._names.has(event.name)) return false;
    this._names.add(event.name);
    if (!this._kinds.has(event.kind)) {
      this._kinds.add(event.kind);
      this._offerKinds();
    }
    return true;
  }

  _forget() {
    const gone = this._events.splice(0, this._events.length - KEPT);
    for (const event of gone) this._names.delete(event.name);
  }

  _offerKinds() {
    const kinds = [...this._kinds].sort();
    const families = [...new Set(kinds.map((kind) => kind.split(".")[0]))];
    const offered = families.flatMap((family) => {
      const own = kinds.filter((kind) => kind.split(".")[0] === family);
      return own.length > 1 ? [[`${family}.`, `${family}: all`], ...own.map((kind) => [kind, kind])] : own.map((kind) => [kind, kind]);
    });
    fill(this._page.kind, [["", "all"], ...offered]);
  }

  _refilter() {
    this._stale = true;
    this._drewAt = -Infinity;
    painter.soon(this._draw);
  }

  _wanted() {
    const { robot, kind, text } = this._page;
    const words = text.value.trim().toLowerCase();
    return (event) =>
      (!robot.value || event.robot === robot.value) &&
      (!kind.value || (kind.value.endsWith(".") ? event.kind.startsWith(kind.value) : event.kind === kind.value)) &&
      (!words || searched(event).includes(words));
  }

  _paint(now) {
    if (now - this._drewAt < DRAW_EVERY_MS) {
      painter.soon(this._draw);
      return;
    }
    this._drewAt = now;
    const wanted = this._wanted();
    const { rows, empty, count } = this._page;
    if (this._stale) {
      const found = [];
      for (let n = this._events.length - 1; n >= 0 && found.length < SHOWN; n--) {
        if (wanted(this._events[n])) found.push(this._events[n]);
      }
      rows.replaceChildren(...found.map(row));
    } else {
      const found = this._fresh.filter(wanted).slice(-SHOWN).reverse();
      rows.prepend(...found.map(row));
      while (rows.childElementCount > SHOWN) rows.lastElementChild.remove();
    }
    this._stale = false;
    this._fresh = [];
    const shown = rows.childElementCount;
    empty.hidden = shown > 0;
    write(empty, this._events.length ? "No event matches the filter." : "No events yet.");
    const known = Math.min(this._events.length, KEPT);
    write(count, known ? `${shown} of ${known} shown, the newest first` : "");
  }

  /** Say aloud what an operator must know; a storm becomes a number. */
  _announce(event) {
    const tone = kindTone(event);
    if (tone !== "bad" && tone !== "good") return;
    this._toSay.push(event);
    if (this._sayTimer) return;
    const waitMs = Math.max(0, this._saidAt + SAY_EVERY_MS - performance.now());
    this._sayTimer = setTimeout(() => this._say(), waitMs);
  }

  _say() {
    this._sayTimer = null;
    this._saidAt = performance.now();
    const events = this._toSay.splice(0);
    const lines = events.slice(0, SAID).map((event) => `${event.robot} ${event.kind.replace(".", " ")}`);
    if (events.length > SAID) lines.push(`and ${events.length - SAID} more events`);
    this._page.said.replaceChildren(el("p", { text: lines.join(". ") }));
  }
}

function row(event) {
  const [before, after] = change(event);
  const name = event.kind === "missed" ? "" : `${event.name}${rawText(event)}`;
  const kind = el("span", { class: "kind", text: event.kind });
  mark(kind, "data-tone", event.tone ?? kindTone(event) ?? null);
  const both = event.kind === "missed" ? after : event.kind === "fault.cleared" ? before : event.kind.startsWith("fault.") || event.kind.startsWith("command.") ? after : `${before} → ${after}`;
  return el(
    "tr",
    { title: name },
    el("td", { class: "time" }, el("time", { datetime: new Date(event.t / 1000).toISOString(), title: fullTime(event.t), text: clock(event.t, true) })),
    el("td", { class: "name", text: event.robot }),
    el("td", {}, kind),
    el("td", { class: "change", text: both }),
  );
}

function rawText(event) {
  const text = JSON.stringify(event.raw ?? {});
  return text === "{}" ? "" : ` · raw ${text.length > 500 ? `${text.slice(0, 500)}…` : text}`;
}

function searched(event) {
  event.words ??= `${event.robot} ${event.kind} ${change(event).join(" ")} ${JSON.stringify(event.raw ?? {})}`.toLowerCase();
  return event.words;
}
