"""A dora node: pass each number on, with which incarnation it was that did so."""

from __future__ import annotations

import os
import struct

from dora import Node  # type: ignore[import-not-found]

MAKER = struct.pack("<q", int(os.environ["MAKER"]))

node = Node()
for event in node:
    if event["type"] == "INPUT":
        node.send_output("made", event["value"].to_numpy().tobytes() + MAKER)
    elif event["type"] == "STOP":
        if not os.environ["HANGING"]:
            os._exit(0)  # the node's own teardown may hang until the daemon kills it
        break
