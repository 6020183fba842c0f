"""What is wrong in a running graph, from what its nodes, readers and launcher say of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from palp_core.counted import counted
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.health import EdgeRow, NodeRow
from palp_core.graph.discovery.standing import Standing
from palp_core.graph.messages.builtin import GraphEvent
from palp_core.view.source.overview import ERROR, SWAPPING, WARN, Trouble

GRAPH_TROUBLE = ("failed", "restarting", "unresponsive", "refused", "swap_failed")
"""Kinds of the launcher's events that are bad news."""


def node_troubles(
    rows: Iterable[NodeRow], silent: Mapping[str, str], found: Iterable[Standing], run: str
) -> Iterator[Trouble]:
    """Yield what is wrong with nodes: what they say themselves first, then who is silent or not at work.

    Args:
        rows: How each does.
        silent: Why a node did not answer, by name.
        found: What nodes say is not ``ok``.
        run: The run's id, which advice names if others run beside it.
    """
    for one in found:
        yield Trouble(f"/{one.node}", ERROR if one.level == "error" else WARN, one.text, one.advice)
    for name, why in silent.items():
        yield Trouble(f"/{name}", ERROR, why, addressed(f"palp logs {name}", run))
    for row in rows:
        if row.responsive and row.state not in ("active", "", "silent", SWAPPING):
            advice = addressed(f"palp lifecycle list {row.name}", run)
            yield Trouble(row.name, WARN, f"it is {row.state}: it handles nothing", advice)


def wire_troubles(rows: Iterable[EdgeRow]) -> Iterator[Trouble]:
    """Yield what readers have not had."""
    for row in rows:
        if row.lost:
            text = f"{counted(row.lost, 'message')} lost, {row.received} received"
            yield Trouble(f"{row.topic} -> {row.reader}", WARN, text, f"palp topic info {row.topic}")


def event_trouble(event: GraphEvent) -> Trouble | None:
    """Return what an event of the launcher says is wrong; None if it is no bad news."""
    if event.kind not in GRAPH_TROUBLE:
        return None
    where = f"/{event.node}" if event.node else "the graph"
    level = ERROR if event.kind == "failed" else WARN
    return Trouble(where, level, f"{event.kind.replace('_', ' ')}: {event.text}", "palp logs")
