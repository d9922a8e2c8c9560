// Reads topics with Foxglove's own client and its own decoder of messages, by the definitions that are advertised; prints JSON.
//
// usage: node foxglove_client.cjs MODULES URL PROTOCOL SECONDS TOPIC:COUNT...
//
// The answer: the subprotocol that was chosen, the serverInfo, the topics that were advertised with their types, the messages
// of each TOPIC without their long arrays, and the size of each that is a JPEG.

const { createRequire } = require("node:module");

const [modules, url, protocol, seconds, ...wanted] = process.argv.slice(2);
const load = createRequire(`${modules}/`);
const { FoxgloveClient } = load("@foxglove/ws-protocol");
const { parse } = load("@foxglove/rosmsg");
const { MessageReader } = load("@foxglove/rosmsg2-serialization");
const jpeg = load("jpeg-js");
const WebSocket = load("ws");

const counts = new Map(wanted.map((text) => [text.slice(0, text.lastIndexOf(":")), Number(text.slice(text.lastIndexOf(":") + 1))]));
const answer = { topics: {}, messages: {}, pictures: {}, log_times: {}, statuses: [] };
for (const topic of counts.keys()) {
  answer.messages[topic] = [];
  answer.pictures[topic] = [];
  answer.log_times[topic] = [];
}

function fail(text) {
  console.error(text);
  process.exit(1);
}

setTimeout(() => fail(`not within ${seconds} s: ${JSON.stringify(answer).slice(0, 4000)}`), seconds * 1000).unref();

const ws = new WebSocket(url, [protocol]);
const client = new FoxgloveClient({ ws });
const subscriptions = new Map();

// Arrays of pixels and latents are only counted.
const brief = (key, value) => {
  if (typeof value === "bigint") return value.toString();
  if (ArrayBuffer.isView(value)) return { length: value.length };
  return value;
};

client.on("error", (error) => fail(`error: ${error}`));
client.on("close", (event) => fail(`closed: ${event.code} ${event.reason}`));
client.on("open", () => { answer.protocol = ws.protocol; });
client.on("serverInfo", (info) => { answer.server_info = info; });
client.on("status", (status) => { answer.statuses.push(status); });
client.on("advertise", (channels) => {
  for (const channel of channels) {
    answer.topics[channel.topic] = channel.schemaName;
    // Each definition has to be one that the library reads.
    const reader = new MessageReader(parse(channel.schema, { ros2: true }));
    if (counts.has(channel.topic)) subscriptions.set(client.subscribe(channel.id), { topic: channel.topic, reader });
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const { topic, reader } = subscriptions.get(subscriptionId);
  if (answer.messages[topic].length >= counts.get(topic)) return;
  const message = reader.readMessage(data);
  if (message.format?.includes("jpeg")) {
    const { width, height } = jpeg.decode(message.data, { useTArray: true });
    answer.pictures[topic].push([width, height]);
  }
  answer.messages[topic].push(JSON.parse(JSON.stringify(message, brief)));
  answer.log_times[topic].push(timestamp.toString());
  if ([...counts].every(([other, count]) => answer.messages[other].length >= count)) {
    process.stdout.write(JSON.stringify(answer), () => process.exit(0));
  }
});
