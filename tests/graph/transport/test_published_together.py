"""What is published together reaches every reader as if each message had been published on its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from palp_core import Message, Node, Pub, Qos, State, Sub, on
from palp_core.errors import NodeError
from palp_core.graph.bag.reader import read
from palp_core.graph.clock import SimClock, WallClock, monotonic_ns
from palp_core.graph.messages.frame import Kind, pack, parse
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.runs import singles
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.bench import Bench
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process import checkpoint
from palp_core.graph.process.keeping import Keeping
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.transport import receiver as receiver_module
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.receiver import TopicReceiver
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from palp_core.units import MetresNonNegative
from tests.support.palp import PATIENCE_S, Palp
from tests.support.stage import Stage
from tests.support.swapping import workspace

WAIT_MS, SLICE_NS = 10, 1_000_000_000


class Word(Message):
    n: int
    depth_m: MetresNonNegative = 0.0


class Heard(State):
    words: list[int] = []
    ticks: list[int] = []


class Reader(Node):
    """Writes down what it hears; done at one word, broken by another."""

    state: Heard
    word = Sub(Word)
    done_at = broken_at = 0

    @on(word)
    def take(self, word: Word) -> None:
        self.state.words.append(word.n)
        if word.n == self.done_at:
            self.finish()
        if word.n == self.broken_at:
            raise ValueError("as asked")


class Talker(Node):
    word = Pub(Word)


class Pair:
    """A publisher and a reader over a real socket, in one process."""

    def __init__(self, folder: Path) -> None:
        self.sockets = NodeSockets(f"ipc://{folder}/p", f"ipc://{folder}/s")
        self.clock = WallClock(monotonic_ns())
        self.talker = Executor(Talker, NodeSpec(name="p", run="m:P"), self.clock, self.sockets.publisher.send)
        self.out: PublisherEnd[Word] = self.talker.ends.publishers["/p/word"]
        self.sockets.publisher.offer(self.talker.ends.publishers.values(), direct=True)
        self.closing: list[Any] = []
        self._begin(self.talker)

    def _begin(self, executor: Executor) -> None:
        executor.transition(Transition.CONFIGURE)
        executor.transition(Transition.ACTIVATE)

    def reader(self, qos: Qos | None = None) -> TopicReceiver:
        spec = NodeSpec(name="r", run="m:R", inputs={"word": "/p/word"}, qos={"word": qos or Qos()})
        executor = Executor(Reader, spec, self.clock, lambda _: None)
        receiver = TopicReceiver(executor, {"/p/word": self.sockets.endpoints}, self.sockets.context, None)
        self._begin(executor)
        self.closing.append(receiver)
        while not receiver.matched:
            self.sockets.poll()
            receiver.receive(SLICE_NS, WAIT_MS)
        receiver.set_start(monotonic_ns())
        while executor.inbox:  # the greeting
            receiver.deliver_next()
        return receiver

    def publish(self, *numbers: int) -> None:
        self.out.publish_all([Word(n=n) for n in numbers])

    def take(self, receiver: TopicReceiver, up_to: int) -> list[int]:
        """Let a reader take up what comes, until that sequence; return all that its node has heard."""
        while receiver.buffers["/p/word"].next <= up_to or receiver._executor.inbox:
            self.sockets.poll()
            self.sockets.requests.perform()
            receiver.receive(SLICE_NS, WAIT_MS)
            while receiver._executor.inbox:
                receiver.deliver_next()
        return words_of(receiver)


def words_of(receiver: TopicReceiver) -> list[int]:
    words: list[int] = receiver._executor.node.state.words  # type: ignore[attr-defined]
    return words


def account_of(receiver: TopicReceiver) -> Any:
    return receiver._executor.ends.subscriptions["/p/word"][0].account


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    made = Pair(tmp_path)
    yield made
    for one in made.closing:
        one.close()
    made.sockets.close()


@pytest.mark.parametrize(
    "qos",
    [
        Qos(),
        Qos(reliability="best_effort", depth=1000),
        Qos(deadline_ms=PATIENCE_S * 1e3),
        Qos(lifespan_ms=PATIENCE_S * 1e3),
        Qos(history="keep_all", depth=500),
    ],
    ids=["reliable", "best effort", "deadline", "lifespan", "keep all"],
)
def test_all_arrive_in_order_whatever_the_quality_of_service(pair: Pair, qos: Qos) -> None:
    receiver = pair.reader(qos)
    pair.publish(1)
    pair.publish(*range(2, 201))
    pair.publish()
    pair.publish(201, 202)
    assert pair.take(receiver, 202) == list(range(1, 203))
    account = account_of(receiver)
    assert (account.received, account.lost, account.repeated, account.dropped) == (202, 0, 0, 0)
    assert receiver.buffers["/p/word"].latency.count == 202


def test_they_leave_in_one_frame_and_are_remembered_each_on_its_own(pair: Pair) -> None:
    listener = SubscriberSocket({"/p/word": pair.sockets.endpoints[0]}, pair.sockets.context)
    pair.closing.append(listener)
    while not pair.out.listened or not pair.sockets.publisher.readers:
        pair.sockets.poll()
    raw = list[bytes]()
    pair.publish(*range(1, 31))
    while len(raw) < 2:  # the greeting, and what was published
        listener.dispatch(lambda frame, _: raw.append(frame), SLICE_NS, WAIT_MS)
    assert len(singles(raw[-1])) == 30
    assert pair.out.history.frames() == singles(raw[-1])[-pair.out.qos.depth :]


def test_each_message_of_a_run_has_its_place_in_the_order_record(pair: Pair) -> None:
    receiver = pair.reader()
    pair.publish(*range(1, 11))
    pair.take(receiver, 10)
    entries = receiver._executor.journal._entries
    assert [(epoch, sequence) for _, epoch, sequence, _ in entries if sequence] == [
        (0, n) for n in range(1, 11)
    ]


def test_a_run_that_takes_long_lets_the_nodes_timers_have_their_turn(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = pair.reader()
    monkeypatch.setattr(receiver_module, "RUN_NS", 0)  # as after half a millisecond of handlers
    pair.publish(*range(1, 11))
    while not words_of(receiver):
        receiver.receive(SLICE_NS, WAIT_MS)
    assert words_of(receiver) == [1]
    assert len(receiver._executor.inbox) == 9  # which the loop hands on between its timers
    assert pair.take(receiver, 10) == list(range(1, 11))
    assert account_of(receiver).received == 10


def test_a_node_that_is_done_in_the_middle_of_a_run_hears_no_more_of_it(pair: Pair) -> None:
    receiver = pair.reader()
    receiver._executor.node.done_at = 4  # type: ignore[attr-defined]
    pair.publish(*range(1, 11))
    while receiver.buffers["/p/word"].next <= 10:
        receiver.receive(SLICE_NS, WAIT_MS)
    assert words_of(receiver) == [1, 2, 3, 4]
    assert account_of(receiver).received == 4


def test_a_handler_that_fails_in_the_middle_of_a_run_has_taken_up_what_came_before(pair: Pair) -> None:
    receiver = pair.reader()
    receiver._executor.node.broken_at = 4  # type: ignore[attr-defined]
    pair.publish(*range(1, 11))
    with pytest.raises(NodeError, match=r"take \(handler of 'word'\) failed: ValueError: as asked"):
        pair.take(receiver, 10)
    assert words_of(receiver) == [1, 2, 3, 4]
    account = account_of(receiver)
    assert (account.received, account.sequence) == (4, 4)


def test_a_run_that_is_missed_is_asked_for_message_by_message(pair: Pair) -> None:
    receiver = pair.reader()
    pair.out.listened = False  # as if ZeroMQ had no room for it
    pair.publish(1, 2, 3)
    pair.out.listened = True
    services = NodeServices(pair.talker, lambda _: {})
    pair.sockets.requests.add("p", services.operations(), CHANGING)
    pair.publish(4, 5, 6)
    assert pair.take(receiver, 6) == [1, 2, 3, 4, 5, 6]
    assert receiver.buffers["/p/word"].filled == 3


def test_of_a_run_with_a_bad_message_the_others_are_taken_and_it_is_named(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    receiver = pair.reader()
    good, bad = encode(Word(n=1)), encode(Word(n=2)).replace(b"\xcb" + bytes(8), b"\xcb\xbf\xf0" + bytes(6))
    run = b"\x93" + good + bad + good
    frame = pack(b"/p/word", Kind.RUN, 0, 1, 0, schema_of(Word).type_hash, run)
    receiver._arrive(frame, monotonic_ns())
    pair.take(receiver, 3)
    assert words_of(receiver) == [1, 1]
    assert "topic /p/word, input 'word'" in caplog.text
    assert receiver._executor.events.rejected_count == 1


def test_a_reader_writes_itself_down_before_each_message_of_a_run(pair: Pair) -> None:
    receiver = pair.reader()
    executor = receiver._executor
    kept: list[tuple[int, int, list[int]]] = []

    def keep(sequence: int, node: bytes) -> None:
        hand_over = checkpoint._decoded(node).hand_over
        account = hand_over.consumed["/p/word"]
        kept.append((sequence, account.sequence, words_of(receiver).copy()))

    Keeping(executor, "/p/word", keep)
    pair.publish(*range(1, 5))
    pair.take(receiver, 4)
    assert kept == [(n, n, list(range(1, n))) for n in range(1, 5)]


def test_a_publisher_that_must_wait_for_room_sends_what_there_is_room_for(pair: Pair) -> None:
    qos = Qos(history="keep_all", depth=8, max_blocking_ms=60_000.0)
    receiver = pair.reader(qos)
    while pair.out.room > 8:
        receiver.tick(monotonic_ns(), 0, 0)
        pair.sockets.poll()
    waits = list[int]()
    honest = pair.out.wait_for_room

    def wait() -> None:
        waits.append(pair.out.sequence)
        while pair.out.sequence >= pair.out.room:
            receiver.receive(SLICE_NS, WAIT_MS)
            while receiver._executor.inbox:
                receiver.deliver_next()
            pair.sockets.poll()
        honest()

    pair.out.wait_for_room = wait
    pair.publish(*range(1, 41))
    assert pair.take(receiver, 40) == list(range(1, 41))
    assert waits


def test_on_a_bench_and_in_simulated_time_each_message_has_its_frame() -> None:
    bench = Bench(Talker)
    bench.node.word.publish_all(Word(n=n) for n in range(5))
    assert [word.n for word in bench.sent(Talker.word)] == list(range(5))
    clock, frames = SimClock(), list[bytes]()
    executor = Executor(Talker, NodeSpec(name="p", run="m:P"), clock, frames.append)
    executor.transition(Transition.CONFIGURE)
    executor.transition(Transition.ACTIVATE)
    executor.ends.publishers["/p/word"].publish_all([Word(n=n) for n in range(5)])
    assert [parse(frame).sequence for frame in frames if frame.startswith(b"/p/word\0")] == [1, 2, 3, 4, 5]


BURSTS = '''
from palp_core import every
from swap_toys import Num, Progress, Relay, Source


class Bursts(Source):
    """Seven numbers at once."""

    @every("rate_hz")
    def go(self):
        first = self.state.index + 1
        self.state.index += 7
        self.out.publish_all([Num(index=index) for index in range(first, first + 7)])
        if first == 1:
            self.progress.publish(Progress(stamp_ns=0, phase="numbers", done_count=1, total_count=2))


class OtherBursts(Bursts):
    pass
'''


@pytest.fixture
def stage(palp: Palp, tmp_path: Path) -> Stage:
    launch = workspace(tmp_path) / "wall.yaml"
    (tmp_path / "bursts.py").write_text(BURSTS)
    launch.write_text(launch.read_text().replace("swap_toys:Source", "bursts:Bursts"))
    return Stage(palp, launch, "rate_hz:=50", "calls_hz:=20", "--record", tmp_path / "bag")


@pytest.mark.parametrize("turns", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_swaps_of_publisher_and_reader_lose_repeat_and_reorder_nothing_and_the_recording_has_each(
    stage: Stage, tmp_path: Path, turns: int
) -> None:
    for turn in range(turns):
        answer = stage.swap(("Other", "Relay")[turn])
        assert answer["report"]["switched"], answer
        stage.passes(20)
        found = stage.graph.swap("source", f"bursts:{('OtherBursts', 'Bursts')[turn]}", timeout_s=PATIENCE_S)
        assert found["report"]["switched"], found
        stage.passes(20)
    _, bad, makers = stage.judgement()
    assert bad == ""
    assert makers == ["Relay", "Other", "Relay"][: turns + 1]
    for node, topic in (("sink", "/relay/out"), ("relay", "/source/out")):
        account = stage.graph.ask(node, "info")["inputs"][topic]
        assert (account["lost"], account["repeated"], account["dropped"]) == (0, 0, 0)
    stage.launcher.terminate()
    assert stage.launcher.wait(PATIENCE_S) == 143
    # A bag has frames as they came: those of both places side by side where its recorder was behind.
    sequences = {message.sequence for message in read(tmp_path / "bag") if message.topic == "/source/out"}
    assert sequences == set(range(1, len(sequences) + 1))
    assert len(sequences) > 100
