// The public Foxglove client, told what to do by lines of JSON on stdin and telling what it sees by lines on stdout.
//
//   node client.mjs ws://127.0.0.1:8765/foxglove foxglove.sdk.v1
//   {"call": "subscribe", "args": [3]}          a method of FoxgloveClient; its value comes back as "returned"
//   {"send": "text"}                            sent as it is, past the client
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const require = createRequire(import.meta.url);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const schemas = require("@foxglove/schemas/jsonschema");
const WebSocket = require("ws");

const [url, protocol] = process.argv.slice(2);
const decoder = new TextDecoder();
const say = (event, value) =>
  process.stdout.write(JSON.stringify({ event, value }, (_, one) => (typeof one === "bigint" ? `${one}` : one)) + "\n");

say("schemas", { Log: schemas.Log, PoseInFrame: schemas.PoseInFrame, FrameTransforms: schemas.FrameTransforms });
const socket = new WebSocket(url, [protocol]);
const client = new FoxgloveClient({ ws: socket });
client.on("open", () => say("open", socket.protocol));
client.on("error", (error) => say("error", String(error)));
client.on("close", (event) => {
  say("close", { code: event.code, reason: event.reason });
  process.exit(0);
});
for (const event of ["serverInfo", "status", "advertise", "unadvertise"]) {
  client.on(event, (value) => say(event, value));
}
client.on("message", ({ subscriptionId, timestamp, data }) =>
  say("message", { subscriptionId, timestamp, payload: JSON.parse(decoder.decode(data)) }),
);

const lines = createInterface({ input: process.stdin });
lines.on("line", (line) => {
  const { call, args, send } = JSON.parse(line);
  if (call != undefined) {
    say("returned", client[call](...args) ?? null);
  } else {
    socket.send(send);
  }
});
lines.on("close", () => client.close());
