/** How values look: words and tones for states, units for people, a dash for what nobody knows. */

export const DASH = "–";

// value → [words, tone]; tones: good, active, warn, bad, idle, unknown
const LINK = {
  ONLINE: ["Online", "good"],
  CONNECTING: ["Connecting", "warn"],
  HANDSHAKING: ["Handshaking", "warn"],
  STALE: ["Stale", "warn"],
  DISCONNECTED: ["Lost", "bad"],
  INCOMPATIBLE: ["Incompatible", "bad"],
  REFUSED: ["Refused", "bad"],
  FAULTED: ["Gateway fault", "bad"],
};
const MODE = {
  MANUAL: ["Manual", "warn"],
  MANUAL_REDUCED_SPEED: ["Manual, reduced speed", "warn"],
  MANUAL_HIGH_SPEED: ["Manual, high speed", "warn"],
  AUTOMATIC: ["Automatic", "good"],
  AUTOMATIC_EXTERNAL: ["Automatic, external", "good"],
  OTHER: ["Other", "idle"],
};
const POWER = {
  OFF: ["Off", "idle"],
  BOOTING: ["Booting", "active"],
  POWERED: ["Powered", "active"],
  ENABLED: ["Enabled", "good"],
  FAULT: ["Fault", "bad"],
};
const MOTION = {
  STANDSTILL: ["Standstill", "idle"],
  MOVING: ["Moving", "active"],
  HOLD: ["Hold", "warn"],
  HAND_GUIDING: ["Hand guiding", "active"],
  EXTERNAL_CONTROL: ["External control", "active"],
  JOGGING: ["Jogging", "active"],
};
const PROGRAM = {
  NONE: ["None", "idle"],
  LOADED: ["Loaded", "idle"],
  RUNNING: ["Running", "active"],
  PAUSED: ["Paused", "warn"],
  STOPPED: ["Stopped", "idle"],
  ERROR: ["Error", "bad"],
};
const SAFETY = {
  NORMAL: ["Normal", "good"],
  REDUCED: ["Reduced", "warn"],
  PROTECTIVE_STOP: ["Protective stop", "bad"],
  SAFEGUARD_STOP: ["Safeguard stop", "bad"],
  EMERGENCY_STOP: ["Emergency stop", "bad"],
  RECOVERY: ["Recovery", "warn"],
  VIOLATION: ["Violation", "bad"],
  FAULT: ["Fault", "bad"],
};
export const WORDS = { link: LINK, mode: MODE, power: POWER, motion: MOTION, program: PROGRAM, safety: SAFETY };

const QUALITY = {
  SUBSTITUTED: "commanded value",
  UNCERTAIN: "uncertain",
  BAD: "bad values",
  STALE: "stale",
  DISCONNECTED: "no link",
};
const KINDS = {
  "mode.changed": MODE,
  "power.changed": POWER,
  "motion.started": MOTION,
  "motion.stopped": MOTION,
  "program.started": PROGRAM,
  "program.paused": PROGRAM,
  "program.stopped": PROGRAM,
  "safety.changed": SAFETY,
  "link.online": LINK,
  "link.lost": LINK,
  "link.incompatible": LINK,
};
const KIND_TONES = {
  "link.online": "good",
  "link.lost": "bad",
  "link.incompatible": "bad",
  "estop.pressed": "bad",
  "estop.released": "good",
  "collision.detected": "bad",
  "collision.cleared": "good",
  "fault.raised": "bad",
  "fault.cleared": "good",
  "command.missed": "bad",
  "program.paused": "warn",
};

/** The words and the tone of a state: null is a dash, an unknown one is said to be. */
export function state(table, value) {
  if (value === null || value === undefined) return [DASH, "unknown"];
  return Object.hasOwn(table, value) ? table[value] : [value === "UNKNOWN" ? "Unknown" : String(value), "unknown"];
}

/** What is the matter with a sample; null: nothing. */
export function quality(q) {
  return q === "GOOD" || !q ? null : (QUALITY[q] ?? q.toLowerCase());
}

export const kindTone = (event) => (event.kind === "safety.changed" ? state(SAFETY, event.to)[1] : KIND_TONES[event.kind]);

/** A number with a fixed number of decimals and a true minus; a dash for null. */
export function number(value, decimals) {
  if (typeof value !== "number" || !Number.isFinite(value)) return DASH;
  const text = value.toFixed(decimals);
  if (!text.startsWith("-")) return text;
  return Number(text) === 0 ? text.slice(1) : `−${text.slice(1)}`;
}

/** A duration in the largest unit that fits. */
export function duration(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  if (whole < 86_400) return `${Math.floor(whole / 3600)} h ${Math.floor((whole % 3600) / 60)} min`;
  return `${Math.floor(whole / 86_400)} d ${Math.floor((whole % 86_400) / 3600)} h`;
}

const TIME = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });
const DATE = new Intl.DateTimeFormat("en-GB", { dateStyle: "medium", timeStyle: "medium" });

/** The local time of day of µs since 1970 UTC. */
export function clock(us, withMs = false) {
  const text = TIME.format(us / 1000);
  return withMs ? `${text}.${String(Math.floor(us / 1000) % 1000).padStart(3, "0")}` : text;
}

export const fullTime = (us) => DATE.format(us / 1000);

/** Degrees about the fixed X, Y and Z axes of a unit quaternion (x, y, z, w); null where it is not known. */
export function rotation(quaternion) {
  if (!Array.isArray(quaternion) || quaternion.length !== 4 || quaternion.some((one) => one === null)) return null;
  const [x, y, z, w] = quaternion;
  const sine = Math.max(-1, Math.min(1, 2 * (w * y - x * z)));
  const degrees = 180 / Math.PI;
  if (Math.abs(sine) > 0.9999999) {
    // at the pole only the sum or the difference is determined: rx carries it, rz is 0
    const rx = 2 * Math.atan2(x, w) * degrees;
    return [((rx + 540) % 360) - 180, Math.sign(sine) * 90, 0];
  }
  const rx = Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y));
  const rz = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
  return [rx * degrees, Math.asin(sine) * degrees, rz * degrees];
}

// unit of the model → [unit for people, factor, offset, decimals]
const SHOWN = {
  rad: ["°", 180 / Math.PI, 0, 2],
  "rad/s": ["°/s", 180 / Math.PI, 0, 2],
  "rad/s²": ["°/s²", 180 / Math.PI, 0, 1],
  m: ["mm", 1000, 0, 2],
  "m/s": ["mm/s", 1000, 0, 1],
  K: ["°C", 1, -273.15, 1],
};

/** How a unit of the model is shown: `{unit, of(value)}`. */
export function shownUnit(unit) {
  const [shown, factor, offset] = SHOWN[unit] ?? [unit === "1" ? "" : (unit ?? ""), 1, 0];
  return { unit: shown, of: (value) => (typeof value === "number" ? value * factor + offset : null) };
}

/** A number with as many digits as it needs. */
export function plain(value) {
  if (!Number.isFinite(value)) return DASH;
  const size = Math.abs(value);
  if (Number.isInteger(value)) return number(value, 0);
  if (size >= 1e7 || size < 1e-4) return value.toExponential(3).replace(/^-/, "−");
  return number(value, size >= 1000 ? 1 : size >= 100 ? 2 : size >= 1 ? 3 : 5);
}

/** Any value of a vendor's field, in one line. */
export function raw(value) {
  if (value === null || value === undefined) return DASH;
  if (typeof value === "number") return plain(value);
  if (Array.isArray(value)) return value.length ? value.map(raw).join("  ") : "[ ]";
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

const MAX_TEXT = 240;

/** What changed, in words: [before, after]. */
export function change(event) {
  const words = (value) => {
    if (value === null || value === undefined) return DASH;
    if (typeof value === "string") return Object.hasOwn(KINDS, event.kind) ? state(KINDS[event.kind], value)[0] : value;
    if (typeof value !== "object") return String(value);
    if (event.kind.startsWith("fault.")) return fault(value);
    if (event.kind.startsWith("command.")) return command(value);
    const text = JSON.stringify(value);
    return text.length > MAX_TEXT ? `${text.slice(0, MAX_TEXT)}…` : text;
  };
  return [words(event.from), words(event.to)];
}

/** A command object, or how it was carried out, in a few words. */
function command({ id, type, index, total, reached, error, text, count }) {
  if (count !== undefined) return `${count} missed`;
  const place = Number.isInteger(index) ? `${index + 1}${total ? ` of ${total}` : ""}` : null;
  const done = reached === true ? "reached" : reached === false ? "not reached" : null;
  const trouble = error ? `error ${raw(error)}` : null;
  return [type ?? "object", place, id ? `in ${id}` : null, done, trouble, text].filter(Boolean).join(" ");
}

/** The name of a fault: the vendor's code and numbers, and its words. */
export function fault({ code, main, sub, text, joint }) {
  const numbers = [main, sub].filter((one) => one !== null && one !== undefined).join(".");
  const place = joint === null || joint === undefined ? "" : ` (joint ${joint + 1})`;
  return `${code}${numbers && ` ${numbers}`}${place}${text ? `: ${text}` : ""}`;
}
