// Read messages of a topic: node read_topic.mjs GRAPH_JSON TOPIC COUNT
import { readFileSync } from "node:fs";
import { decode } from "@msgpack/msgpack";
import { Subscriber } from "zeromq";

const [file, topic, count] = process.argv.slice(2);
const graph = JSON.parse(readFileSync(file, "utf8"));
const socket = new Subscriber();
socket.connect(graph.topics.find((entry) => entry.name === topic).publish);
socket.subscribe(`${topic}\0`);
const floats = (bytes) => [...new Float64Array(new Uint8Array(bytes).buffer)]; // a copy is aligned
let left = Number(count);
for await (const [frame] of socket) {
  const header = Buffer.byteLength(topic) + 1;
  const [version, kind] = frame.subarray(header);
  if (version !== 2 || kind !== 0) continue; // another version, or a heartbeat
  const fields = decode(frame.subarray(header + 32));
  const message = Object.entries(fields).map(([name, value]) => [name, value instanceof Uint8Array ? floats(value) : value]);
  console.log(`${frame.readBigUInt64LE(header + 8)} ${JSON.stringify(Object.fromEntries(message))}`);
  if (--left <= 0) break;
}
socket.close();
