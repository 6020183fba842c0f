// Call a service: node call_service.mjs GRAPH_JSON /NODE/SERVICE JSON
import { randomUUID } from "node:crypto";
import { readFileSync } from "node:fs";
import { decode, encode } from "@msgpack/msgpack";
import { Dealer } from "zeromq";

const [file, target, text] = process.argv.slice(2);
const [node, service] = target.split("/").slice(1);
const graph = JSON.parse(readFileSync(file, "utf8"));
const socket = new Dealer({ receiveTimeout: 2000 });
socket.connect(graph.nodes.find((entry) => entry.name === node).serve);
const request = { op: "call", node, service, request: JSON.parse(text), id: randomUUID() };
let reply;
for (let attempt = 0; attempt < 3 && !reply; attempt++) {
  await socket.send(encode(request)); // with the same id, the node does nothing twice
  reply = await socket.receive().then(([body]) => decode(body), () => undefined);
}
if (!reply || reply.error) throw new Error(reply?.error ?? `/${node} does not answer`);
console.log(JSON.stringify(reply.reply));
socket.close();
