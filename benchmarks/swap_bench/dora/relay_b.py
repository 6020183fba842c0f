"""A dora node: the other relay; it packs number and incarnation anew."""

from __future__ import annotations

import os
import struct

from dora import Node  # type: ignore[import-not-found]

maker = int(os.environ["MAKER"])

node = Node()
for event in node:
    if event["type"] == "INPUT":
        (index,) = struct.unpack("<q", event["value"].to_numpy())
        node.send_output("made", struct.pack("<qq", index, maker))
    elif event["type"] == "STOP":
        if not os.environ["HANGING"]:
            os._exit(0)  # the node's own teardown may hang until the daemon kills it
        break
