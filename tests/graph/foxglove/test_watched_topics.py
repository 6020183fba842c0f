"""Topics as a screen wants them: while somebody looks, no faster than it can show, always with the latest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.graph.discovery.graph_reader import GraphReader
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.foxglove.watched_topics import WatchedTopics
from palp_core.graph.messages.frame import Frame
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.topic import topic_of
from tests.support.fake_graph import FakeGraph, FakeNode, Sample


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[FakeGraph]:
    graph = FakeGraph(tmp_path)
    yield graph
    graph.close()


class Reader:
    """Watches the topic of a fake node; until something is so, the graph goes on and it reads."""

    def __init__(self, graph: FakeGraph, node: FakeNode, fastest_hz: float) -> None:
        self._graph, self._node = graph, node
        self.topic = topic_of(node.out.topic, Sample, "source", node.at[0])
        graph.announce(node)
        assert graph.bus.record is not None
        self.reader = GraphReader(RunningGraph(graph.bus.record))
        self.watched = WatchedTopics(self.reader, fastest_hz)
        self.seen: list[int] = []

    def begin(self, *, every: bool = False) -> None:
        self.watched.watch([self.topic], every=every)
        self._graph.until(lambda: self._node.out.has_readers)

    def read_until(self, index: int) -> None:
        def so() -> bool:
            self.seen += [decode(Sample, frame.payload).index for frame in self.take()]
            return index in self.seen

        self._graph.until(so)

    def take(self) -> list[Frame]:
        return self.watched.receive(0)


@pytest.mark.parametrize(("every", "least"), [(False, 2), (True, 100)])
def test_a_fast_topic_is_thinned_its_latest_comes_when_it_is_due_and_if_wanted_every_message(
    graph: FakeGraph, every: bool, least: int
) -> None:
    node = graph.node("source", depth=1)
    reader = Reader(graph, node, 5.0)
    reader.begin(every=every)
    node.say(100)
    reader.read_until(99)
    assert reader.seen[0] == 0
    assert least <= len(reader.seen) <= (100 if every else 99)
    reader.reader.close()


def test_a_topic_that_is_left_is_not_sent_any_more(graph: FakeGraph) -> None:
    node = graph.node("source", depth=1)
    reader = Reader(graph, node, 0.0)
    reader.begin()
    reader.watched.leave([reader.topic.name])
    graph.until(lambda: not node.out.has_readers)
    assert not reader.reader.follows(reader.topic.name)
    reader.begin()  # and may be looked at again
    node.say(1)
    reader.read_until(0)
    reader.reader.close()
