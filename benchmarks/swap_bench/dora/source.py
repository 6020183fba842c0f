"""A dora node: numbers from 0 on at 1 kHz by its own timer, until the file ``end`` is in its folder."""

from __future__ import annotations

import gc
import struct
import time
from pathlib import Path

from dora import Node  # type: ignore[import-not-found]

PERIOD_NS = 1_000_000
END = Path(__file__).with_name("end")


def main() -> None:
    """Send until told to end, then write how many were sent."""
    node = Node()
    gc.collect()
    gc.freeze()
    index, begin_ns = 0, time.monotonic_ns()
    while not END.exists():
        node.send_output("index", struct.pack("<q", index))
        index += 1
        left_ns = begin_ns + index * PERIOD_NS - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / 1e9)  # noqa: TID251 - the source's own pace; there is no event to wait for
    count = END.with_name("sent.part")
    count.write_text(str(index))
    count.rename(END.with_name("sent"))
    for event in node:  # its end would be the end of the relay's input
        if event["type"] == "STOP":
            break


main()
