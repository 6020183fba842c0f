"""A recorder as an entry of a launch file.

The launcher gives it a process of its own kind: it takes no part in the graph's time, and is ready before the
first node is active, so that every topic's first message is in the bag.
"""

from typing import Annotated, Literal

from msgspec import Meta

from palp_core.graph.node.node import Node, Params, ReadOnly
from palp_core.units import Count, Seconds


class RecorderParams(Params):
    """What to record, and how; the flags of ``palp bag record``.

    Attributes:
        out: The bag, from where you are; it must not exist.
        topics: Names; none and no ``regex``: every topic, the hidden ones too.
        regex: Topics in which it is found are recorded as well.
        exclude_regex: Topics in which it is found are not.
        max_bag_size: Bytes of a file, after which another is begun; 0: one file.
        max_bag_duration_s: The same by time.
        snapshot_s: Keep so much in memory and write it on ``palp bag snapshot``; 0: write at once.
        required: The graph ends if the recorder does.
    """

    out: ReadOnly[Annotated[str, Meta(min_length=1)]]
    topics: ReadOnly[list[str]] = []
    regex: ReadOnly[str] = ""
    exclude_regex: ReadOnly[str] = ""
    max_bag_size: ReadOnly[Count] = 0
    max_bag_duration_s: ReadOnly[Seconds] = 0.0
    snapshot_s: ReadOnly[Seconds] = 0.0
    compression: ReadOnly[Literal["zstd", "lz4", "none"]] = "zstd"
    required: ReadOnly[bool] = False


class Recorder(Node):
    """Record the graph into a bag."""

    params: RecorderParams
