"""A graph at one moment, as a page shows it: plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from palp_core.graph.discovery.troubles import Trouble
from palp_core.graph.node.spec import action_of

UNKNOWN = "unknown"
ACTION = "action"
"""In place of a message's type."""
SUMMED = ("received", "lost", "late", "dropped", "rate_hz")


class NodeState(msgspec.Struct, frozen=True, kw_only=True):
    """A node: class, state and figures; ``health`` is ``ok``, ``warn``, ``error``, or unknown as in a bag.

    ``lifecycle`` is ``silent`` where the node does not answer; ``rate_hz`` counts ticks and messages.
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

    What is unknown is None: for a bag the whole account, as bags do not record it.
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
    """All of a graph, or of a bag, by ``kind``; ``now_s`` is on its clock, ``elapsed_s`` since the launch."""

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


def actions_as_one(wires: Sequence[WireState]) -> list[WireState]:
    """Return wires in which all parts of an action between two nodes are one, where the first of them was.

    Counts and rates are summed, latencies are the worst; what no part knows stays unknown.
    """
    servers = dict(_called(wire.topic for wire in wires))
    found: dict[tuple[str, str, str], WireState] = {}
    for wire in wires:
        whole = _whole(wire, servers)
        known = found.get(key := (whole.source, whole.reader, whole.topic))
        found[key] = whole if known is None else _both(known, whole)
    return list(found.values())


def _called(topics: Iterable[str]) -> Iterable[tuple[str, str]]:
    """Yield what clients name their ends of actions, ``/carrier/move``, and the servers theirs.

    Both stand in the name of a reply: ``/arm/move/_action/send_goal/carrier/move/_action/send_goal``.
    """
    for topic in topics:
        server = action_of(topic)
        _, _, client = topic.removeprefix(f"{server}/_action/").partition("/")
        if server and (asks := action_of(f"/{client}")):
            yield asks, server


def _whole(wire: WireState, servers: dict[str, str]) -> WireState:
    action = action_of(wire.topic)
    if not action:
        return wire
    if action in servers:  # a call, as its server hears it
        return msgspec.structs.replace(wire, topic=servers[action], type=ACTION)
    return msgspec.structs.replace(wire, topic=action, source=wire.reader, reader=wire.source, type=ACTION)


def _both(one: WireState, other: WireState) -> WireState:
    def known(name: str) -> list[Any]:
        return [value for wire in (one, other) if (value := getattr(wire, name)) is not None]

    sums = {name: sum(values) if (values := known(name)) else None for name in SUMMED}
    worst = {name: max(known(name), default=None) for name in ("latency_p50_s", "latency_p99_s")}
    return msgspec.structs.replace(one, **sums, **worst)
