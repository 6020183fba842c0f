"""Which running graph, and which of its topics, a verb is about; the modules that know wait until then."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from palp_core.cli.output import note

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.messages.topic import Topic


def find_graph(name: str | None, *, changes: bool = False) -> RunningGraph:
    """Return the running graph that ``--graph`` names, or that of this folder; say which if there are others.

    Args:
        name: Its name, id or pid.
        changes: The verb changes something: if several may be meant, none is taken; otherwise the latest is.

    Raises:
        GraphError: None runs, none of that name, or several may be meant.
    """
    from palp_core.graph.discovery.choice import choose
    from palp_core.graph.discovery.running_graph import RunningGraph

    record, others = choose(name, sole=changes)
    if others:
        more = f"{len(others)} more {'is' if len(others) == 1 else 'are'} running"
        note(f"graph {record}; {more}: palp graph list")
    return RunningGraph(record)


def find_topics(graph: RunningGraph, names: Iterable[str]) -> list[Topic]:
    """Return the topics of those names, each once.

    Raises:
        GraphError: There is none of a name; the nearest is in the message.
    """
    return list({topic.name: topic for topic in map(graph.topic, names)}.values())


def note_ended(graph: RunningGraph) -> None:
    """Say that a graph has ended, which is why the verb does."""
    note(f"graph '{graph.record.graph}' has ended")
