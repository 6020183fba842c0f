// Publish into an external port: node publish.mjs GRAPH_JSON /NODE/PORT JSON
import { readFileSync } from "node:fs";
import { decode, encode } from "@msgpack/msgpack";
import { Dealer } from "zeromq";

const [file, target, text] = process.argv.slice(2);
const [node, port] = target.split("/").slice(1);
const graph = JSON.parse(readFileSync(file, "utf8"));
const socket = new Dealer({ receiveTimeout: 5000 });
socket.connect(graph.nodes.find((entry) => entry.name === node).serve);
await socket.send(encode({ op: "publish", node, port, message: JSON.parse(text) }));
const reply = decode((await socket.receive())[0]);
if (reply.error) throw new Error(reply.error);
console.log(JSON.stringify(reply));
socket.close();
