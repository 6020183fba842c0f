"""Topics that are looked at: read at once, kept only as far as shown, let go when no one looks."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import Frame
from palp_core.view.source import feed as feeds
from palp_core.view.source.feed import Feeds, TopicWatch, decode_sample
from tests.support.fake_graph import FakeGraph

THREAD = "palp view: topics"


@pytest.fixture
def graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeGraph]:
    monkeypatch.setattr(RunningGraph, "alive", True)
    found = FakeGraph(tmp_path)
    found.announce(found.node("source", depth=10))
    yield found
    found.close()


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
