"""A dora node: write each number, its maker and its time of arrival to the file ``rows``, as three int64."""

from __future__ import annotations

import gc
import struct
import time
from pathlib import Path

from dora import Node  # type: ignore[import-not-found]

node = Node()
gc.collect()
gc.freeze()
with Path(__file__).with_name("rows").open("wb", buffering=0) as rows:
    for event in node:
        if event["type"] == "INPUT":
            arrived_ns = time.monotonic_ns()
            rows.write(event["value"].to_numpy().tobytes() + struct.pack("<q", arrived_ns))
        elif event["type"] == "STOP":
            break
