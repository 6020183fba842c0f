"""Messages that the runtime itself knows."""

from __future__ import annotations

from palp_core.runtime.message import Message
from palp_core.units import Count, Nanoseconds, Probability

__all__ = ["Order", "Progress"]


class Progress(Message):
    """How far a run is; shown by the launch view.

    ``score`` is a live figure between 0 and 1, such as an accuracy, and counts only where ``score_defined``.
    """

    stamp_ns: Nanoseconds
    phase: str
    done_count: Count
    total_count: Count
    text: str = ""
    score: Probability = 0.0
    score_defined: bool = False
    busy_s: float = 0.0


class Order(Message):
    """What a node consumed and in which order: enough to drive it again to the same outputs.

    The i-th entry is ``sources[source[i]]``: ``activate``, ``input:<port>``, ``reply:<client>``,
    ``call:<service><client topic>``, ``timer:<name>`` or ``parameters``; with its epoch and sequence (of a
    timer the tick number k, of a change of parameters its place in ``changes``, JSON) and the node's time.
    ``hand_over``, where not empty, is the node's encoded hand-over before the first entry: a place to start.
    """

    stamp_ns: Nanoseconds
    sources: list[str]
    source: list[int]
    epoch: list[int]
    sequence: list[int]
    now_ns: list[int]
    changes: list[str]
    hand_over: bytes
