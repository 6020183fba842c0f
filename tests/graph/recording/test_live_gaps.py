"""A recorder of a running graph asks for what it misses, and lists what no publisher has any more."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from palp_core import Node
from palp_core.errors import BagError
from palp_core.graph.bag.reader import read
from palp_core.graph.bag.recorder import RecordingSummary
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import encode_any
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import topic_of
from palp_core.graph.node.bench import Bench
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.recording import live_feed, live_recorder
from palp_core.graph.recording.live_feed import ANSWER_NS, LiveFeed
from palp_core.graph.recording.live_recorder import LiveRecorder
from palp_core.graph.recording.recorder_params import RecorderParams
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.fake_graph import FakeGraph, FakeNode, Sample
from tests.support.palp import Palp


@pytest.fixture
def graph(palp: Palp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeGraph]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    fake = FakeGraph(tmp_path)
    yield fake
    fake.close()


class Recording:
    """A recorder in a thread of its own, while the test speaks for the graph."""

    def __init__(
        self, graph: FakeGraph, bag: Path, *topics: str, regex: str = "", begins: str = "recording "
    ) -> None:
        self._graph = graph
        self._params = RecorderParams(out=str(bag), topics=list(topics), regex=regex)
        self._notes: list[str] = []
        self._stop = threading.Event()
        self._summary: RecordingSummary | None = None
        self._thread = threading.Thread(target=self._record)
        self._thread.start()
        self.until_noted(begins)

    def _record(self) -> None:
        assert self._graph.bus.record is not None
        graph = RunningGraph(self._graph.bus.record)
        recorder = LiveRecorder(graph, self._params, self._notes.append, from_start=False)
        recorder.await_topics(self._stop.is_set)
        while not self._stop.is_set():
            recorder.turn()
        self._summary = recorder.close(patient=False)

    def until_noted(self, start: str) -> None:
        def noted() -> bool:
            assert self._thread.is_alive(), self._notes
            return any(note.startswith(start) for note in self._notes)

        self._graph.until(noted)

    def end(self) -> RecordingSummary:
        self._stop.set()
        self._graph.until(lambda: not self._thread.is_alive())
        assert self._summary is not None
        return self._summary


def received(graph: FakeGraph, node: FakeNode) -> None:
    """Wait until everything that was sent so far has left."""
    ear = SubscriberSocket({node.out.topic: node.at[0]})
    try:
        beats: list[bytes] = []

        def beat() -> bool:
            beats.extend(ear.receive())
            return any(parse(raw).sequence == node.out.sequence for raw in beats)

        graph.until(beat)
    finally:
        ear.close()


def kept(graph: FakeGraph, node: FakeNode, recorder: Recording, bag: Path) -> list[int]:
    """End a recorder that has missed nothing; return what it has of a node's topic, epoch by epoch."""
    received(graph, node)
    summary = recorder.end()
    assert summary.complete, summary.text()
    return [n for _, n in sorted((m.epoch, m.sequence) for m in read(bag, [node.out.topic]))]


def test_what_was_missed_is_asked_for(graph: FakeGraph, tmp_path: Path) -> None:
    source = graph.node("source", depth=100)
    graph.announce(source)
    recorder = Recording(graph, tmp_path / "bag", "/source/sample")
    source.say(10)
    source.lose(5)
    source.say(10)
    source.lose(3)
    source.sockets.publisher.send_heartbeats()  # nothing but the heartbeat reveals a lost tail
    assert kept(graph, source, recorder, tmp_path / "bag") == list(range(1, 29))


def test_what_no_publisher_has_any_more_is_listed_per_topic_and_ends_non_zero(
    palp: Palp, graph: FakeGraph, tmp_path: Path
) -> None:
    source = graph.node("source", depth=1)
    graph.announce(source)
    recorder = palp.start("bag", "record", "/source/sample", "-o", tmp_path / "bag")
    graph.until_printed(recorder, "recording ")
    source.say(10)
    source.lose(5)
    source.say(2)
    received(graph, source)
    recorder.send_signal(signal.SIGINT)
    graph.until(lambda: recorder.poll() is not None)
    assert recorder.stdout is not None
    assert "/source/sample: 5 missing of 17: 11..15" in recorder.stdout.read()
    assert recorder.returncode == 1
    info = palp.run("bag", "info", tmp_path / "bag", "--json")
    assert info.returncode == 1
    topic = json.loads(info.stdout)["topics"]["/source/sample"]
    assert (topic["count"], topic["lost"]) == (12, 5)
    assert topic["gaps"] == [{"epoch": 0, "first": 11, "last": 15}]


def test_what_a_node_takes_up_later_is_recorded_though_it_was_published_before(
    graph: FakeGraph, tmp_path: Path
) -> None:
    source = graph.node("source", depth=100)
    publisher = source.sockets.publisher
    order = PublisherEnd("/source/_order", Order, Qos(depth=1), 0, source, publisher.send)
    publisher.offer([order])
    graph.announce(source)
    source.say(10)
    recorder = Recording(graph, tmp_path / "bag", source.out.topic, order.topic)
    source.say(5)
    consumed = {source.out.topic: SequenceAccount(epoch=0, sequence=7)}
    state = msgspec.structs.replace(Bench(Node).hand_over(), consumed=consumed)
    empty: dict[str, Any] = {"sources": [], "source": [], "epoch": [], "sequence": [], "now_ns": []}
    order.publish(Order(stamp_ns=0, hand_over=encode_any(state), changes=[], **empty))
    assert kept(graph, source, recorder, tmp_path / "bag") == list(range(8, 16))


def test_a_publisher_that_is_replaced_is_followed_without_a_gap(graph: FakeGraph, tmp_path: Path) -> None:
    old = graph.node("source", depth=1)
    graph.announce(old)
    recorder = Recording(graph, tmp_path / "bag", "/source/sample")
    old.say(10)
    new = graph.node("source-2", depth=1)
    old.moved("prepare", new)
    graph.until(lambda: new.sockets.publisher.has_subscribers)
    old.say(5)
    new.out.resume(old.out.epoch, old.out.sequence, [])
    new.say(20)
    old.moved("gone", new)
    assert kept(graph, new, recorder, tmp_path / "bag") == list(range(1, 36))


def test_a_restarted_publisher_counts_from_one_again(graph: FakeGraph, tmp_path: Path) -> None:
    first = graph.node("source", depth=50)
    graph.announce(first)
    recorder = Recording(graph, tmp_path / "bag", "/source/sample")
    first.say(10)
    second = graph.node("source-2", depth=50, epoch=1)
    second.say(4)  # before anybody can hear it
    graph.announce(second)
    graph.until(lambda: second.sockets.publisher.has_subscribers)
    second.say(3)
    assert kept(graph, second, recorder, tmp_path / "bag") == [*range(1, 11), *range(1, 8)]


def test_a_topic_that_appears_later_is_recorded_too(graph: FakeGraph, tmp_path: Path) -> None:
    source = graph.node("source", depth=10)
    graph.announce(source)
    recorder = Recording(graph, tmp_path / "bag", regex="^/source/[a-z]")
    other = graph.node("other", depth=10, port="other")
    graph.announce(source, other)
    recorder.until_noted("also recording /source/other")
    graph.until(lambda: other.sockets.publisher.has_subscribers)
    other.say(7)
    assert kept(graph, other, recorder, tmp_path / "bag") == list(range(1, 8))


def test_a_topic_without_a_message_is_noted_and_missing(
    graph: FakeGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_recorder, "NOTE_WAITING_NS", 100_000_000)
    source, mute = graph.node("source", depth=10), graph.node("mute", depth=10, port="other")
    graph.announce(source, mute)
    graph.nodes.remove(mute)  # it greets no reader
    recorder = Recording(graph, tmp_path / "bag", "/source/sample", "/source/other", begins="no message yet")
    source.say(10)
    received(graph, source)
    summary = recorder.end()
    mute.sockets.close()
    assert not summary.complete
    assert "no message: /source/other" in summary.text()
    assert [message.sequence for message in read(tmp_path / "bag", ["/source/sample"])] == list(range(1, 11))


def test_a_graph_in_simulated_time_is_recorded_by_its_launcher(graph: FakeGraph, tmp_path: Path) -> None:
    graph.announce(graph.node("source", depth=1))
    assert graph.bus.record is not None
    simulated = msgspec.structs.replace(graph.bus.record, clock="sim")
    params = RecorderParams(out=str(tmp_path / "bag"))
    with pytest.raises(BagError, match="palp launch FILE --record DIR"):
        LiveRecorder(RunningGraph(simulated), params, print, from_start=False)
    assert not (tmp_path / "bag").exists()


def test_answers_of_a_publisher_that_is_gone_are_waited_for_once_and_not_for_each_gap(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    now_ns = [10**12]
    monkeypatch.setattr(live_feed, "monotonic_ns", lambda: now_ns[0])
    directory = RunDirectory("gone")
    gone = topic_of("/source/sample", Sample, "source", f"ipc://{directory.path}/source.pub")
    graph = RunningGraph(directory.record("gone", "", "wall", f"ipc://{directory.path}/graph.srv", [], []))
    feed = LiveFeed(graph, cast(Any, None), from_start=True)  # no frame comes
    feed.follow({gone.name: gone})
    for first in range(1, 60, 2):
        feed.ask(gone.name, 0, first, first)
    assert feed.asking
    assert feed.answered_since(now_ns[0] - ANSWER_NS)
    now_ns[0] += ANSWER_NS + 1
    assert not feed.answered_since(now_ns[0] - ANSWER_NS)
    feed.close()
    directory.remove()
