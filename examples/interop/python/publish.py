"""Publish into an external port with pyzmq and msgpack only: python publish.py GRAPH_JSON /NODE/PORT JSON."""

import json
import sys
from pathlib import Path

import msgpack
import zmq

graph, (node, port) = json.loads(Path(sys.argv[1]).read_text()), sys.argv[2].strip("/").split("/")
socket = zmq.Context().socket(zmq.DEALER)
socket.setsockopt(zmq.RCVTIMEO, 5000)
socket.connect({entry["name"]: entry["serve"] for entry in graph["nodes"]}[node])
request = {"op": "publish", "node": node, "port": port, "message": json.loads(sys.argv[3])}
socket.send(msgpack.packb(request))
reply = msgpack.unpackb(socket.recv())
sys.exit(reply.get("error") or print(json.dumps(reply)))
