"""An action as one wire from its client to its server, though its parts are services and topics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from palp_core.graph.node.spec import action_of
from palp_core.view.source.overview import WireState

ACTION = "action"
"""In place of a message's type."""
SUMMED = ("received", "lost", "late", "dropped", "rate_hz")


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
