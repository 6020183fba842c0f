"""Read messages of a topic with pyzmq and msgpack only: python read_topic.py GRAPH_JSON TOPIC COUNT."""

import json
import struct
import sys
from pathlib import Path

import msgpack
import zmq

graph, topic, count = json.loads(Path(sys.argv[1]).read_text()), sys.argv[2].encode(), int(sys.argv[3])
socket = zmq.Context().socket(zmq.SUB)
socket.connect({entry["name"]: entry["publish"] for entry in graph["topics"]}[sys.argv[2]])
socket.subscribe(topic + b"\0")
while count > 0:
    frame, body = socket.recv(), len(topic) + 33
    version, kind, _, epoch, sequence, stamp_ns, type_hash = struct.unpack_from("<BBHIQqQ", frame, body - 32)
    if version == 2 and kind == 0:  # the others are heartbeats
        fields = msgpack.unpackb(frame[body:])
        arrays = {k: memoryview(v).cast("d").tolist() for k, v in fields.items() if isinstance(v, bytes)}
        print(sequence, json.dumps(fields | arrays), flush=True)
        count -= 1
