"""Which running graph, and which of its topics, a verb is about; the modules that know wait until then."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from palp_core.cli.output import note

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.topic import Topic


def find_graph(name: str | None, *, changes: bool = False) -> RunningGraph:
    """Return the running graph of this name, id or pid, or that of this folder; note it if others run.

    If several fit, a verb that ``changes`` something is refused; any other takes the latest.
    """
    from palp_core.graph.discovery.choice import choose
    from palp_core.graph.discovery.running_graph import RunningGraph

    record, others = choose(name, sole=changes)
    if others:
        more = f"{len(others)} more {'is' if len(others) == 1 else 'are'} running"
        note(f"graph {record}; {more}: palp graph list")
    return RunningGraph(record)


def find_topics(graph: RunningGraph, names: Iterable[str]) -> list[Topic]:
    return list({topic.name: topic for topic in map(graph.topic, names)}.values())


def note_ended(graph: RunningGraph) -> None:
    note(f"graph '{graph.record.graph}' has ended")


def published_text(reader: TopicReader, topic: str) -> str:
    """Return how many messages a silent topic has had."""
    count = reader.last_sequence.get(topic)
    return "its publisher does not answer" if count is None else f"{count} published so far"
