"""Which running graph, and which of its topics, a verb is about; the modules that know wait until then."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from palp_core.cli.output import note

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.messages.topic import Topic


def find_graph(name: str | None) -> RunningGraph:
    """Return the running graph that ``--graph`` names, or the latest.

    Raises:
        GraphError: None runs, or none of that name.
    """
    from palp_core.graph.discovery.running_graph import RunningGraph

    return RunningGraph.find(name)


def find_topics(graph: RunningGraph, names: Iterable[str]) -> list[Topic]:
    """Return the topics of those names, each once.

    Raises:
        GraphError: There is none of a name; the nearest is in the message.
    """
    return list({topic.name: topic for topic in map(graph.topic, names)}.values())


def note_ended(graph: RunningGraph) -> None:
    """Say that a graph has ended, which is why the verb does."""
    note(f"graph '{graph.record.graph}' has ended")
