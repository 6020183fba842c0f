"""A running graph as a source, and its topics that are looked at, of a graph that a test speaks for."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import NodeEntry
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.frame import Frame
from palp_core.graph.node.loading import endpoints
from palp_core.view.source import feed as feeds
from palp_core.view.source.feed import Feeds, TopicWatch, decode_sample
from palp_core.view.source.live import LiveSource
from palp_core.view.source.overview import Overview, WireState
from tests.support.fake_graph import FakeGraph, edge_health, health_of

BEAT_NS = 20_000_000


def health(received: int, lost: int = 0, lifecycle: str = "active") -> NodeHealth:
    edges = edge_health(received, lost, 1e-3)
    return health_of("sink", edges, lifecycle=lifecycle, counted_ns=monotonic_ns())


class Shown:
    """The graph, its launcher saying how a node does, and the source that looks on."""

    def __init__(self, graph: FakeGraph) -> None:
        self.graph = graph
        assert graph.bus.record is not None
        self.source = LiveSource(RunningGraph(graph.bus.record), period_s=0.01)
        self.now, self.more = health(0), list[NodeHealth]()
        self._next_ns = 0

    def until(self, so: Callable[[Overview], bool]) -> Overview:
        """Let the launcher speak until the overview is so."""
        self.graph.until(lambda: self._is(so))
        return self.source.overview()

    def join(self, name: str) -> None:
        """Let a node join: the launcher writes it into its record, and says how it does."""
        record = self.graph.bus.record
        assert record is not None
        node = NodeEntry(
            name, f"nodes.{name}:{name.title()}", 0, *endpoints(str(self.graph.directory.path), name)
        )
        self.graph.bus.record = msgspec.structs.replace(record, nodes=[*record.nodes, node])
        self.graph.directory.write(self.graph.bus.record)
        self.more.append(health_of(name, counted_ns=monotonic_ns()))

    def _is(self, so: Callable[[Overview], bool]) -> bool:
        if monotonic_ns() > self._next_ns:
            self._next_ns = monotonic_ns() + BEAT_NS
            self.graph.bus.publish_health([self.now, *self.more])
        return so(self.source.overview())


@pytest.fixture
def graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeGraph]:
    monkeypatch.setattr(RunningGraph, "alive", True)
    found = FakeGraph(tmp_path)
    found.announce(found.node("source", depth=10))
    yield found
    found.close()


@pytest.fixture
def shown(graph: FakeGraph, monkeypatch: pytest.MonkeyPatch) -> Iterator[Shown]:
    found = Shown(graph)
    yield found
    monkeypatch.setattr(RunningGraph, "alive", False)
    found.source._closed.set()
    found.source._wake.set()
    graph.until(lambda: not found.source._thread.is_alive())


def wire(overview: Overview) -> WireState:
    (found,) = overview.wires
    return found


def test_wires_rates_and_losses_are_those_of_the_readers_own_account(shown: Shown) -> None:
    overview = shown.until(lambda it: bool(it.wires and it.now_s))
    assert (wire(overview).source, wire(overview).reader) == ("source", "sink")
    assert overview.troubles == []
    assert shown.source.known
    shown.now = health(1000)
    assert (wire(shown.until(lambda it: bool(it.wires[0].received == 1000))).rate_hz or 0) > 0
    shown.now = health(1000, lost=3)
    overview = shown.until(lambda it: bool(it.wires[0].lost == 3))
    assert [trouble.text for trouble in overview.troubles] == ["3 messages lost, 1000 received"]
    assert overview.nodes[0].health == "warn"


def test_a_node_that_joins_appears_with_its_class(shown: Shown) -> None:
    shown.until(lambda it: bool(it.wires))
    shown.join("late")
    shown.until(lambda it: ("late", "nodes.late:Late") in [(node.name, node.run) for node in it.nodes])


def test_a_node_that_is_inactive_and_one_that_restarts_are_shown(shown: Shown) -> None:
    shown.now = health(0, lifecycle="inactive")
    overview = shown.until(lambda it: bool(it.nodes[0].lifecycle == "inactive"))
    assert "it is inactive" in overview.troubles[0].text
    shown.graph.bus.report("restarting", "sink", "it died")
    overview = shown.until(lambda it: bool(len(it.troubles) == 2))
    assert overview.troubles[1].text == "restarting: it died"
    assert [event.kind for event in shown.source.events()] == ["restarting"]


def test_a_graph_that_has_ended_is_shown_as_it_was_last(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown.now = health(7)
    shown.until(lambda it: bool(it.wires and it.wires[0].received == 7))
    monkeypatch.setattr(RunningGraph, "alive", False)
    overview = shown.until(lambda it: bool(not it.alive))
    assert wire(overview).received == 7
    assert overview.troubles[0].text.startswith("it has ended")


THREAD = "palp view: topics"


@pytest.fixture
def known(graph: FakeGraph) -> RunningGraph:
    assert graph.bus.record is not None
    return RunningGraph(graph.bus.record)


def listened(graph: FakeGraph, *, so: bool) -> None:
    graph.until(lambda: graph.nodes[0].out.has_readers is so)


def last(watch: TopicWatch) -> int:
    found = watch.latest()
    return found.sequence if found is not None else 0


def test_what_comes_is_seen_and_nothing_is_kept_unasked(graph: FakeGraph, known: RunningGraph) -> None:
    all_feeds = Feeds(known)
    watch = all_feeds.watch(known.topic("/source/sample"))
    listened(graph, so=True)
    graph.nodes[0].say(5)
    graph.until(lambda: last(watch) == 5)
    assert watch.read_new() == []  # what came before was for the last message only
    graph.nodes[0].say(3)
    graph.until(lambda: last(watch) == 8)
    assert [one.message["index"] for one in watch.read_new()] == [5, 6, 7]
    assert watch.read_new() == []
    all_feeds.close()
    listened(graph, so=False)


def test_two_who_look_share_what_is_read_and_the_last_one_ends_it(
    graph: FakeGraph, known: RunningGraph
) -> None:
    all_feeds = Feeds(known)
    first, second = (all_feeds.watch(known.topic("/source/sample")) for _ in range(2))
    listened(graph, so=True)
    assert len([one for one in threading.enumerate() if one.name == THREAD]) == 1
    first.close()
    first.close()
    graph.nodes[0].say(1)
    graph.until(lambda: last(second) == 1)
    second.close()
    listened(graph, so=False)


def test_a_page_that_does_not_ask_keeps_no_more_than_its_bound(
    graph: FakeGraph, known: RunningGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "MOST_BYTES", 100)
    all_feeds = Feeds(known)
    watch = all_feeds.watch(known.topic("/source/sample"))
    watch.read_new()
    listened(graph, so=True)
    graph.nodes[0].say(1000)
    graph.until(lambda: last(watch) == 1000)
    kept = watch.read_new()
    assert 1 <= len(kept) <= 20
    assert kept[-1].sequence == 1000
    all_feeds.close()
    listened(graph, so=False)


def test_a_message_that_is_too_large_or_no_message_is_reported_and_not_shown(known: RunningGraph) -> None:
    topic = known.topic("/source/sample")
    for payload, words in (
        (bytes(2 << 20), "2097152 bytes"),
        (b"\xc1", "not msgpack"),
        (b"\x01", "not a map"),
    ):
        frame = Frame(topic.name, 0, 0, 1, 0, 0, memoryview(payload))
        assert words in str(decode_sample(frame, topic).message["(not shown)"])
