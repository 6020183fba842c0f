"""Call a service with pyzmq and msgpack only: python call_service.py GRAPH_JSON /NODE/SERVICE JSON."""

import json
import sys
import uuid
from pathlib import Path

import msgpack
import zmq

graph, (node, service) = json.loads(Path(sys.argv[1]).read_text()), sys.argv[2].strip("/").split("/")
socket = zmq.Context().socket(zmq.DEALER)
socket.connect({entry["name"]: entry["serve"] for entry in graph["nodes"]}[node])
request = {"op": "call", "node": node, "service": service, "request": json.loads(sys.argv[3])}
request["id"] = uuid.uuid4().hex  # asked again with it, the node does nothing twice
for _ in range(3):
    socket.send(msgpack.packb(request))
    if socket.poll(2000):
        reply = msgpack.unpackb(socket.recv())
        sys.exit(reply.get("error") or print(json.dumps(reply["reply"])))
sys.exit(f"/{node} does not answer")
