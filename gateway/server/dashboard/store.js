/** What the page knows of each robot: the newest sample of each group, and what the robot can never tell. */

/** One robot, as the gateway names it. */
export class Robot {
  constructor(info) {
    this.info = info;
    this.name = info.name;
    this.samples = {}; // by group
    this.never = new Set(); // "status.power": this robot's protocol cannot tell
    if (info.link) this.samples.link = { data: info.link, q: "GOOD", t: 0, epoch: "", times: {} };
  }

  /** Keep a sample; one with only some fields renews only these, and none that is newer already. */
  take(group, sample) {
    const known = this.samples[group];
    const same = known?.epoch === sample.epoch;
    const times = same ? known.times : {};
    const data = { ...known?.data };
    for (const [key, value] of Object.entries(sample.data)) {
      if (times[key] > sample.t) continue; // two subscriptions to a topic are not in step
      times[key] = sample.t;
      data[key] = value;
    }
    this.samples[group] = { ...(same && known.t > sample.t ? known : sample), data, times };
  }

  data(group) {
    return this.samples[group]?.data ?? {};
  }

  get online() {
    return this.data("link").state === "ONLINE";
  }

  /** When the last frame came, in µs UTC; null: not known. */
  get lastFrame() {
    for (const group of ["joints", "status", "tcp", "safety"]) {
      const last = this.samples[group]?.t_last;
      if (last) return last;
    }
    return null;
  }

  /** What an operator has to see of it, the worst first: [words, tone]. */
  attention() {
    const found = [];
    const { state } = this.data("link");
    const status = this.data("status");
    const safety = this.data("safety");
    if (state === "CONNECTING" || state === "HANDSHAKING") found.push(["connecting", "warn"]);
    else if (state === "STALE") found.push(["stale", "warn"]);
    else if (state && state !== "ONLINE") found.push([state === "DISCONNECTED" ? "lost" : state.toLowerCase(), "bad"]);
    if (!this.online) return found;
    if (status.e_stopped === true || safety.state === "EMERGENCY_STOP") found.push(["emergency stop", "bad"]);
    else if (SAFETY_STOPS[safety.state]) found.push(SAFETY_STOPS[safety.state]);
    if (safety.collision || safety.self_collision) found.push(["collision", "bad"]);
    if (status.faults?.length) found.push([status.faults.length === 1 ? "fault" : `${status.faults.length} faults`, "bad"]);
    else if (status.in_error || status.power === "FAULT" || status.program?.state === "ERROR") found.push(["error", "bad"]);
    return found;
  }
}

const SAFETY_STOPS = {
  PROTECTIVE_STOP: ["protective stop", "bad"],
  SAFEGUARD_STOP: ["safeguard stop", "bad"],
  VIOLATION: ["safety violation", "bad"],
  FAULT: ["safety fault", "bad"],
  REDUCED: ["reduced", "warn"],
  RECOVERY: ["recovery", "warn"],
};

/** A topic's name as a glob that matches nothing else. */
export function exact(topic) {
  return topic.replace(/[*?[]/g, "[$&]");
}
