"""A graph at one moment, as a page shows it: plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import msgspec

from palp_core.graph.discovery.troubles import Trouble

UNKNOWN = "unknown"


class NodeState(msgspec.Struct, frozen=True, kw_only=True):
    """A node: what it is, how it does, and why if not well.

    Attributes:
        name: Without the slash.
        run: Its class, ``module:Class``.
        lifecycle: As ROS 2 has it; ``silent`` where the node does not answer; :data:`SWAPPING`.
        health: ``ok``, ``warn`` or ``error``; ``unknown`` where nobody tells, as in a bag.
        why: What is wrong, in words; "" if nothing is.
        rate_hz: Ticks and messages handled a second; None where that is unknown.
    """

    name: str
    run: str = ""
    lifecycle: str = ""
    health: str = UNKNOWN
    why: str = ""
    pid: int = 0
    cpu_percent: float | None = None
    memory_bytes: int = 0
    rate_hz: float | None = None
    moves: bool = False


def shared_processes(nodes: Sequence[NodeState]) -> dict[int, int]:
    """Return how many nodes work in each process that several of them share, by its number."""
    count = Counter(node.pid for node in nodes if node.pid)
    return {pid: number for pid, number in count.items() if number > 1}


class WireState(msgspec.Struct, frozen=True, kw_only=True):
    """A topic on its way to one reader, with the reader's own account; times in s.

    Whatever is unknown is None: of a bag all of the account, as nobody has recorded what readers had.
    """

    topic: str
    source: str
    reader: str
    type: str = ""
    rate_hz: float | None = None
    received: int | None = None
    lost: int | None = None
    late: int | None = None
    dropped: int | None = None
    latency_p50_s: float | None = None
    latency_p99_s: float | None = None


class Overview(msgspec.Struct, frozen=True, kw_only=True):
    """All of a graph.

    Attributes:
        kind: ``graph`` or ``bag``.
        run: Id of the run; of a bag its folder.
        clock: ``sim`` or ``wall``.
        now_s: Time on the graph's clock; None while the launcher does not tell.
        elapsed_s: Seconds since the launch, by this machine's time of day.
        alive: The graph still runs.
    """

    kind: str
    title: str
    run: str = ""
    clock: str = ""
    now_s: float | None = None
    elapsed_s: float | None = None
    alive: bool = True
    nodes: list[NodeState] = []
    wires: list[WireState] = []
    troubles: list[Trouble] = []

    @property
    def moves_something_real(self) -> bool:
        """Whether a node of it moves something, and that not in simulated time."""
        return self.clock == "wall" and any(node.moves for node in self.nodes)
