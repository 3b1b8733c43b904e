/**
 * The JavaScript client of the native protocol, in one file: for browsers, and for every runtime with a WebSocket.
 *
 *     const gateway = connect("ws://127.0.0.1:8765/ws");
 *     gateway.subscribe(["*\/joints"], { rateHz: 10, onSample: (sample) => console.log(sample.topic, sample.data) });
 *
 * It reconnects by itself, asks for its subscriptions anew and reads events on where it stopped.
 * See docs/client-js.md; the messages are those of docs/protocol.md.
 */

const SUBPROTOCOL = "robot-gateway.v1+json";
const CONNECT_MS = 4000;
const PING_EVERY_MS = 1500;
const PING_ANSWER_MS = 4000;
const BACK_OFF_MS = [200, 5000];

/** A request was refused, or cannot be answered; `code` is stable: the gateway's, or LOST or CLOSED. */
export class GatewayError extends Error {
  constructor(code, message) {
    super(message);
    this.name = "GatewayError";
    this.code = code;
  }
}

/**
 * Connect to the native door of a gateway, for ever: `close()` ends it.
 *
 * Options: `token`, for a gateway that asks for one. It is said as the subprotocol `bearer.<token>`, never in the address,
 * and stands in no error.
 */
export function connect(url, options = {}) {
  return new Gateway(url, options);
}

/** Whether a text may be a token at all: only then can it be said in a handshake. */
export function isToken(text) {
  return typeof text === "string" && /^[\w!#$%&'*+.^`|~-]+$/.test(text);
}

/**
 * A lasting connection.
 *
 * - `state`: "connecting", "live", "lost" (it tries again by itself) or "closed"; `reason`: why it was lost.
 * - `welcome`: what the gateway said first; null before.
 * - `onstate(state, reason)`: called when the state changes.
 * - `onerror(error)`: called when the gateway refuses a subscription that nobody waits for.
 */
export class Gateway {
  #token;

  constructor(url, { token = null } = {}) {
    if (token !== null && !isToken(token)) throw new GatewayError("BAD_TOKEN", "the token is empty or has characters that no token has");
    this.#token = token;
    this.url = String(url);
    this.state = "connecting";
    this.reason = null;
    this.welcome = null;
    this.onstate = null;
    this.onerror = null;
    this._subscriptions = new Map(); // by id
    this._asked = new Map(); // id → {resolve, reject}
    this._queue = []; // requests that wait for the connection
    this._nextId = 1;
    this._backOffMs = BACK_OFF_MS[0];
    this._clockMs = null; // gateway's clock minus ours
    this._bestTripMs = Infinity;
    this._open();
  }

  /** The gateway's clock as far as it is known, in ms since 1970 UTC. */
  now() {
    return Date.now() + (this._clockMs ?? 0);
  }

  /** Every robot with the state of its link. */
  async robots() {
    return (await this.ask("robots")).robots ?? [];
  }

  /** The latest samples of some topics, once. */
  async get(topics) {
    return (await this.ask("get", { topics })).samples ?? [];
  }

  /** What a topic holds: JSON Schema with units, and where each value comes from. */
  async describe(topic) {
    return (await this.ask("describe", { topic })).description;
  }

  /** Events read back from the rings, after those named `since`. */
  async events({ since, limit, topics } = {}) {
    return (await this.ask("events", { since, limit, topics })).events ?? [];
  }

  /** Ask anything of the protocol; waits for the connection, and fails with a GatewayError. */
  ask(op, values = {}) {
    if (this.state === "closed") return Promise.reject(new GatewayError("CLOSED", "the client is closed"));
    const id = this._nextId++;
    return new Promise((resolve, reject) => {
      const request = { id, text: JSON.stringify({ op, id, ...values }), resolve, reject };
      if (this.state === "live") this._send(request);
      else this._queue.push(request);
    });
  }

  /**
   * Ask for topics until closed, over every reconnect.
   *
   * Options: `rateHz`, `mode`, `fields` as in the protocol; `since`: names of events to read on after; and what is
   * called: `onSample(sample)`, `onEvent(event)`, `onMissed({samples, events})`, `onTopics(names, lastEvents)`.
   *
   * A sample goes to every subscription that its topic belongs to. Where two ask for different `fields` of one topic,
   * `undefined` means "not in this sample" and `null` "the robot cannot tell".
   */
  subscribe(topics, options = {}) {
    const subscription = new Subscription(this, `s${this._nextId++}`, topics, options);
    this._subscriptions.set(subscription.id, subscription);
    if (this.state === "live") this._subscribe(subscription);
    return subscription;
  }

  /** Try again at once, for instance because the network is back. */
  retry() {
    if (this.state !== "lost") return;
    clearTimeout(this._retryTimer);
    this._open();
  }

  /** End it. */
  close() {
    this._drop("closed", "closed by the client");
    this._subscriptions.clear();
  }

  _open() {
    this._say("connecting", this.reason);
    let socket;
    try {
      socket = new WebSocket(this.url, this.#token === null ? SUBPROTOCOL : [SUBPROTOCOL, `bearer.${this.#token}`]);
    } catch (error) {
      this._drop("closed", error.message); // no address at all: trying again cannot help
      throw error;
    }
    this._socket = socket;
    this._deadline = setTimeout(() => this._lost("the gateway does not answer"), CONNECT_MS);
    socket.onmessage = (frame) => this._take(JSON.parse(frame.data));
    socket.onclose = (end) => this._lost(end.reason || (end.wasClean ? "the gateway has gone" : "no connection"));
  }

  _take(message) {
    switch (message.op) {
      case "data":
        for (const sample of message.samples) this._each(sample.topic, "onSample", sample);
        break;
      case "event":
        for (const event of message.events) this._takeEvent(event);
        break;
      case "missed":
        for (const subscription of this._subscriptions.values()) call(subscription.options.onMissed, message);
        break;
      case "welcome":
        this._greet(message);
        break;
      case "result":
        this._settle(message.id, (request) => request.resolve(message));
        break;
      case "error":
        this._settle(message.id, (request) => request.reject(new GatewayError(message.code, message.message)));
        break;
    }
  }

  _greet(welcome) {
    clearTimeout(this._deadline);
    this.welcome = welcome;
    this._backOffMs = BACK_OFF_MS[0];
    this._clockMs = null;
    this._bestTripMs = Infinity;
    this._say("live", null);
    for (const subscription of this._subscriptions.values()) {
      subscription._await(); // what another one resumes before this one's answer is not for it
      this._subscribe(subscription);
    }
    for (const request of this._queue.splice(0)) this._send(request);
    this._ping();
  }

  _takeEvent(event) {
    const topic = `${event.robot}/${event.kind.startsWith("command.") ? "commands" : "events"}`;
    const [boot, seq] = split(event.name);
    for (const subscription of [...this._subscriptions.values()]) {
      if (!subscription._takes(topic)) continue;
      const known = subscription.rings.get(boot);
      if (known !== undefined && seq <= known) continue; // two subscriptions read the same ring from different places
      subscription.rings.set(boot, seq);
      call(subscription.options.onEvent, event);
    }
  }

  _each(topic, handler, value) {
    for (const subscription of [...this._subscriptions.values()]) {
      if (subscription._takes(topic)) call(subscription.options[handler], value);
    }
  }

  _subscribe(subscription) {
    const { rateHz, mode, fields, since } = subscription.options;
    const { id, topics, rings } = subscription;
    const resumed = rings.size ? [...rings].map(([boot, seq]) => `${boot}:${seq}`) : since;
    const wish = { op: "subscribe", id, topics, rate_hz: rateHz, mode, fields, since: resumed };
    const resolve = (result) => {
      subscription._answer(result.topics);
      subscription._readFrom(result.last_events ?? [], resumed !== undefined);
      call(subscription.options.onTopics, result.topics, result.last_events ?? []);
    };
    const reject = (error) => {
      if (error.code !== "LOST" && error.code !== "CLOSED") call(this.onerror, error);
    };
    this._send({ id, text: JSON.stringify(wish), resolve, reject });
  }

  _settle(id, how) {
    const waiting = this._asked.get(id);
    if (!waiting) return;
    if (waiting.length === 1) this._asked.delete(id);
    how(waiting.shift()); // one subscription may be asked for again before its first answer
  }

  _send(request) {
    this._asked.set(request.id, [...(this._asked.get(request.id) ?? []), request]);
    this._socket.send(request.text);
  }

  _ping() {
    const asked = Date.now();
    this._deadline = setTimeout(() => this._lost("the gateway does not answer"), PING_ANSWER_MS);
    const resolve = (result) => {
      clearTimeout(this._deadline);
      const tripMs = Date.now() - asked;
      if (tripMs <= this._bestTripMs) {
        this._bestTripMs = tripMs;
        this._clockMs = result.t / 1000 - (asked + tripMs / 2);
      }
      this._bestTripMs += 1; // an old measurement is worth less than a new one, for clocks drift
      this._pingTimer = setTimeout(() => this._ping(), PING_EVERY_MS);
    };
    const id = this._nextId++;
    this._send({ id, text: JSON.stringify({ op: "ping", id }), resolve, reject: () => {} });
  }

  _lost(reason) {
    this._drop("lost", reason);
    const delayMs = this._backOffMs * (0.7 + 0.6 * Math.random());
    this._backOffMs = Math.min(2 * this._backOffMs, BACK_OFF_MS[1]);
    this._retryTimer = setTimeout(() => this._open(), delayMs);
  }

  _drop(state, reason) {
    for (const timer of [this._deadline, this._pingTimer, this._retryTimer]) clearTimeout(timer);
    const socket = this._socket;
    this._socket = null;
    if (socket) {
      socket.onmessage = socket.onclose = null;
      socket.close();
    }
    const open = [...[...this._asked.values()].flat(), ...(state === "closed" ? this._queue.splice(0) : [])];
    this._asked.clear();
    for (const request of open) request.reject(new GatewayError(state === "closed" ? "CLOSED" : "LOST", reason));
    this._say(state, reason);
  }

  _say(state, reason) {
    if (this.state === state && this.reason === reason) return;
    this.state = state;
    this.reason = reason;
    call(this.onstate, state, reason);
  }
}

/** One subscription of a gateway; `matched`: the names of its topics, also of those that came later. */
class Subscription {
  constructor(gateway, id, topics, options) {
    this.id = id;
    this.topics = topics;
    this.options = options;
    this._await();
    this.rings = new Map(); // boot → seq of the last event
    this._gateway = gateway;
  }

  /** Ask for other topics, or with other options, in the place of these. */
  update(topics, options = {}) {
    this.topics = topics;
    Object.assign(this.options, options);
    if (this._gateway.state === "live") this._gateway._subscribe(this);
  }

  /** End it. */
  close() {
    if (!this._gateway._subscriptions.delete(this.id) || this._gateway.state !== "live") return;
    const text = JSON.stringify({ op: "unsubscribe", id: this.id });
    this._gateway._send({ id: this.id, text, resolve: () => {}, reject: () => {} });
  }

  _await() {
    this.matched = new Set();
    this._others = null; // names that its globs do not match; null: it is not answered yet
  }

  _answer(names) {
    this.matched = new Set(names);
    this._others = new Set();
    this._globs = this.topics.map(expression);
  }

  /** Whether a topic is one of its own: of those that it was answered with, or of a robot that was added since. */
  _takes(topic) {
    if (this.matched.has(topic)) return true;
    if (this._others === null || this._others.has(topic)) return false;
    const own = this._globs.some((glob) => glob.test(topic));
    (own ? this.matched : this._others).add(topic);
    return own;
  }

  _readFrom(lastEvents, resumed) {
    const last = new Map(lastEvents.map(split));
    for (const boot of this.rings.keys()) if (!last.has(boot)) this.rings.delete(boot); // of a gateway that is no more
    for (const [boot, seq] of last) if (!this.rings.has(boot)) this.rings.set(boot, resumed ? 0 : seq);
  }
}

/** Call a handler of the user; what it throws is told by the page's own means, and costs no other message. */
function call(handler, ...args) {
  try {
    handler?.(...args);
  } catch (error) {
    queueMicrotask(() => {
      throw error;
    });
  }
}

function split(name) {
  const at = name.lastIndexOf(":");
  return [name.slice(0, at), Number(name.slice(at + 1))];
}

/** A topic glob as a regular expression: `*` and `?` as everywhere, `[abc]`, `[a-c]` and `[!abc]` for one character. */
function expression(glob) {
  const source = glob.replace(/\[(!?)(\]?[^\]]*)\]|[\s\S]/g, (part, not, set) => {
    if (set !== undefined) return `[${not ? "^" : ""}${set.replace(/[\\\]^[]/g, "\\$&")}]`;
    if (part === "*") return "[^]*";
    return part === "?" ? "[^]" : part.replace(/[\\^$.|+()[\]{}/]/, "\\$&");
  });
  try {
    return new RegExp(`^${source}$`);
  } catch {
    return /(?!)/; // such as [z-a]: it matches nothing
  }
}
