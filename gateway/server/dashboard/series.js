/** What a chart can show of a topic, and the last 60 s of it. */

import { rotation, shownUnit } from "./format.js";

export const WINDOW_S = 60;
const SPARE_S = 5;
const XYZ = ["X", "Y", "Z"];
const TWIST = ["X", "Y", "Z", "RX", "RY", "RZ"];
const MAX_DEPTH = 6;

/**
 * The fields of a topic that are numbers, from its JSON Schema.
 *
 * Returns `{path, label, unit}` each: a dotted path as `fields` of a subscription takes it, and the unit of the model.
 */
export function numericFields(description) {
  const found = [];
  walk(description.schema, description.schema, [], "", found, 0);
  return found;
}

function walk(root, schema, path, text, found, depth) {
  const own = description(root, schema) || text;
  const plain = resolve(root, schema);
  if (!plain || depth > MAX_DEPTH) return;
  const unit = schema.unit ?? plain.unit ?? null;
  const items = plain.type === "array" || hasType(plain, "array") ? resolve(root, plain.items ?? {}) : null;
  if (isNumber(plain) || (items && isNumber(items))) {
    if (path.length) found.push({ path: path.join("."), unit: unit ?? items?.unit ?? null, text: own });
    return;
  }
  for (const [name, below] of Object.entries(plain.properties ?? {})) {
    walk(root, below, [...path, name], own, found, depth + 1);
  }
}

/** Look through `anyOf: [something, null]` and references. */
function resolve(root, schema) {
  if (schema.$ref?.startsWith("#/")) {
    const target = schema.$ref.slice(2).split("/").reduce((at, name) => at?.[name], root);
    return target && resolve(root, target);
  }
  if (schema.anyOf) {
    const kept = schema.anyOf.filter((one) => one.type !== "null");
    return kept.length === 1 ? { ...resolve(root, kept[0]), ...(schema.unit ? { unit: schema.unit } : {}) } : kept.find((one) => isNumber(one));
  }
  return schema;
}

const description = (root, schema) => schema.description ?? "";
const hasType = (schema, type) => Array.isArray(schema.type) && schema.type.includes(type);
const isNumber = (schema) => ["number", "integer"].some((type) => schema.type === type || hasType(schema, type));

/** The value at a dotted path; undefined: it is not in this sample. */
export function at(data, path) {
  let value = data;
  for (const name of path.split(".")) {
    if (value === null) return null;
    if (value === undefined || typeof value !== "object") return undefined;
    value = value[name];
  }
  return value;
}

/** How the values of a field become lines: `{unit, names(n), rows(value)}`. */
export function lines(group, field) {
  if (field.path.endsWith("orientation")) {
    return { unit: "°", turns: true, names: () => ["RX", "RY", "RZ"], values: (value) => rotation(value) ?? [null, null, null] };
  }
  const parts = (field.unit ?? "").split(", ").map(shownUnit);
  const one = parts[0];
  const unit = parts.map((part) => part.unit).join(", ");
  const convert = (value, n) => (parts.length > 1 && n > 2 ? parts[1] : one).of(value);
  const names = (count, isArray) => {
    if (!isArray) return [field.path.split(".").at(-1)];
    if (group === "joints") return Array.from({ length: count }, (_, n) => `J${n + 1}`);
    const known = count === 3 ? XYZ : count === 6 && field.path.includes("twist") ? TWIST : null;
    return known ?? Array.from({ length: count }, (_, n) => `${n + 1}`);
  };
  const values = (value) => (Array.isArray(value) ? value.map(convert) : [convert(value, 0)]);
  return { unit, turns: false, names, values };
}

/** The last 60 s: times in ms and a row of values each; a row of null is a gap. */
export class Series {
  constructor() {
    this.times = [];
    this.rows = [];
    this._epoch = null;
  }

  /** Add a row; one that is not newer than the last is passed over. */
  add(t, values, epoch) {
    const last = this.times.at(-1);
    if (last !== undefined && t <= last) return false;
    if (this._epoch !== null && epoch !== this._epoch && values) this.gap(t - 0.001);
    this._epoch = epoch;
    this.times.push(t);
    this.rows.push(values);
    if (this.times.length % 256 === 0) this._forget(t - (WINDOW_S + SPARE_S) * 1000);
    return true;
  }

  /** From here nothing is known. */
  gap(t) {
    const last = this.times.at(-1);
    if (last === undefined || this.rows.at(-1) === null) return;
    this.times.push(Math.max(t, last + 0.001));
    this.rows.push(null);
  }

  /** The index of the first row at or after a time. */
  from(t) {
    let low = 0;
    let high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The index of the row nearest to a time; -1: there is none near, or it is a gap. */
  nearest(t, withinMs) {
    const after = this.from(t);
    let best = -1;
    for (const n of [after - 1, after]) {
      if (!this.rows[n] || Math.abs(this.times[n] - t) > withinMs) continue;
      if (best < 0 || Math.abs(this.times[n] - t) < Math.abs(this.times[best] - t)) best = n;
    }
    return best;
  }

  /** A copy that does not move on. */
  copy() {
    const made = new Series();
    made.times = [...this.times];
    made.rows = [...this.rows];
    return made;
  }

  _forget(before) {
    const keep = this.from(before);
    if (keep > 0) {
      this.times.splice(0, keep);
      this.rows.splice(0, keep);
    }
  }
}
