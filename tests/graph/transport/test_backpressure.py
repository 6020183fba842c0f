"""A publisher waits for a reader that holds it, and hears of what its readers lose."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from palp_core import Message, Node, Pub, Qos, QosEvent, State, Sub, on, on_event
from palp_core.errors import PublishTimeout
from palp_core.graph.clock import WallClock, monotonic_ns
from palp_core.graph.messages.frame import LAST_SEQUENCE, Kind, pack
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.transport.acks import (
    ACK,
    FLOW_CONTROL,
    FlowControl,
    is_waited_for,
    read_ack,
    read_flow_control,
)
from palp_core.graph.transport.backpressure import REPORT_NS
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.receiver import TopicReceiver
from tests.support.drive import Drive
from tests.support.palp import Palp
from tests.support.supervised import write_files

DEPTH = 8
SLICE_NS = 1_000_000_000
HELD = Qos(history="keep_all", depth=DEPTH, max_blocking_ms=20.0)


class Word(Message):
    n: int


class HeardState(State):
    heard: list[int] = []


class Talker(Node):
    word = Pub(Word)


class Generous(Node):
    word = Pub(Word, qos=HELD)


class Heedful(Node):
    state: HeardState
    word = Pub(Word)

    @on_event(word)
    def mind(self, event: QosEvent) -> None:
        self.state.heard.append(event.count_change)


class Listener(Node):
    state: HeardState
    word = Sub(Word)

    @on(word)
    def take(self, word: Word) -> None:
        self.state.heard.append(word.n)


class Pair:
    """A publisher and its readers in this process; each does something when the test says so."""

    def __init__(self, folder: Path, talker: type[Node] = Talker) -> None:
        self.places = f"ipc://{folder}/p", f"ipc://{folder}/s"
        self.sockets = NodeSockets(*self.places)
        self.clock = WallClock(monotonic_ns())
        self.talker = Executor(talker, NodeSpec(name="p", run="m:P"), self.clock, self.sockets.publisher.send)
        self.out: Any = self.talker.ends.publishers["/p/word"]
        self.sockets.publisher.offer(self.talker.ends.publishers.values())
        self.begin(self.talker)
        self.readers: list[TopicReceiver] = []
        self.listeners: list[Executor] = []

    def begin(self, executor: Executor) -> None:
        executor.transition(Transition.CONFIGURE)
        executor.transition(Transition.ACTIVATE)

    def reader(self, name: str = "r", qos: Qos = HELD) -> TopicReceiver:
        spec = NodeSpec(name=name, run="m:R", inputs={"word": "/p/word"}, qos={"word": qos})
        executor = Executor(Listener, spec, self.clock, lambda _: None)
        receiver = TopicReceiver(executor, {"/p/word": self.places}, self.sockets.context, None)
        self.begin(executor)
        self.readers.append(receiver)
        self.listeners.append(executor)
        while not receiver.matched:
            self.sockets.poll()
            receiver.receive(SLICE_NS)
        self.hear(lambda: not is_waited_for(qos) or name in backpressure_of(self).readers)
        receiver.set_start(monotonic_ns())
        return receiver

    def publish(self, count: int) -> None:
        for _ in range(count):
            self.out.publish(Word(n=self.out.sequence + 1))

    def take(self, receiver: TopicReceiver, up_to: int) -> None:
        """Let a reader take up what comes, until it has a message."""
        while receiver.buffers["/p/word"].next <= up_to or receiver._executor.inbox:
            receiver.receive(SLICE_NS)
            while receiver._executor.inbox:
                receiver.deliver_next()

    def report_losses(self) -> None:
        for out, change in self.sockets.publisher.backpressure.newly_lost(monotonic_ns()):
            self.talker.ends.report_overrun(out, change)

    def hear(self, until: Callable[[], bool]) -> None:
        """Let the readers look ten times a second, as it were, and the publisher hear them, until it has."""
        while not until():
            for receiver in self.readers:
                receiver.tick(monotonic_ns(), 0, 0)
            self.sockets.poll()

    def wait_for_room(self, room: int) -> None:
        """Let the publisher hear its readers until they have made room for so many messages."""
        while self.out.room < room:
            self.sockets.poll()

    def close(self) -> None:
        for receiver in self.readers:
            receiver.close()
        self.sockets.close()


def backpressure_of(pair: Pair) -> Any:
    return pair.sockets.publisher.backpressure._topics["/p/word"]


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    made = Pair(tmp_path)
    yield made
    made.close()


def test_publish_waits_for_a_reader_that_holds_it_and_then_fails_by_name_and_sends_nothing(
    pair: Pair,
) -> None:
    reader = pair.reader("slow")
    pair.publish(DEPTH)
    with pytest.raises(
        PublishTimeout, match=r"/p/word: reader 'slow' is 8 messages behind .* 20 ms"
    ) as caught:
        pair.publish(1)
    assert (caught.value.topic, caught.value.reader) == ("/p/word", "slow")
    assert isinstance(caught.value, TimeoutError)
    assert pair.out.sequence == DEPTH
    pair.take(reader, DEPTH)
    pair.wait_for_room(DEPTH + 1)  # the reader says so as it takes them up, without a look of its loop
    pair.publish(1)
    pair.take(reader, DEPTH + 1)
    assert pair.listeners[0].node.state.heard == list(range(1, DEPTH + 2))  # type: ignore[attr-defined]


def test_what_the_runtime_publishes_waits_for_no_reader(pair: Pair) -> None:
    pair.reader()
    pair.publish(DEPTH)
    pair.out.put(Word(n=0))  # as events, the order and what is given from outside
    pair.out.forward(b"\x81\xa1n\x01")
    assert pair.out.sequence == DEPTH + 2


def test_what_is_kept_for_a_reader_is_as_much_as_it_may_be_behind(pair: Pair) -> None:
    pair.reader(qos=Qos(history="keep_all", depth=50, max_blocking_ms=20.0))
    pair.publish(50)
    assert len(pair.out.history) == 50
    with pytest.raises(PublishTimeout):
        pair.publish(1)


def test_a_reader_that_asks_for_keep_last_or_is_best_effort_holds_nobody(pair: Pair) -> None:
    pair.reader("one", Qos(depth=DEPTH))
    pair.reader("other", Qos(history="keep_all", depth=DEPTH, reliability="best_effort"))
    pair.publish(5 * DEPTH)
    assert pair.out.room == LAST_SEQUENCE


def test_the_slowest_of_several_readers_is_waited_for_and_one_that_has_gone_no_longer(pair: Pair) -> None:
    quick, slow = pair.reader("quick"), pair.reader("slow")
    pair.publish(DEPTH)
    pair.take(quick, DEPTH)
    with pytest.raises(PublishTimeout, match="'slow'"):
        pair.publish(1)
    pair.readers.remove(slow)
    slow.close()
    pair.take(quick, DEPTH)
    pair.wait_for_room(DEPTH + 1)  # its end is seen without its doing
    pair.publish(1)
    pair.take(quick, DEPTH + 1)


def test_a_reader_that_comes_later_is_owed_nothing_from_before(pair: Pair) -> None:
    pair.publish(5 * DEPTH)
    pair.reader()
    pair.publish(DEPTH)
    with pytest.raises(PublishTimeout):
        pair.publish(1)


def test_a_reader_that_was_deactivated_or_is_done_holds_nobody(pair: Pair) -> None:
    reader = pair.reader()
    pair.publish(1)
    pair.take(reader, 1)
    pair.listeners[0].finish(0)
    for _ in range(5):
        up_to = pair.out.sequence
        pair.hear(lambda up_to=up_to: pair.out.room == up_to + DEPTH)  # type: ignore[misc]
        pair.publish(DEPTH)
        pair.take(reader, up_to + DEPTH)
    assert pair.listeners[0].node.state.heard == [1]  # type: ignore[attr-defined]


def test_a_publisher_that_keeps_back_what_it_publishes_waits_for_nobody(pair: Pair) -> None:
    reader = pair.reader()
    pair.sockets.publisher.hold()
    pair.publish(3 * DEPTH)
    pair.sockets.publisher.release()
    pair.take(reader, 3 * DEPTH)


def test_a_successor_takes_its_predecessors_readers_for_no_further_behind_than_they_may_be(
    pair: Pair,
) -> None:
    pair.reader()
    pair.sockets.publisher.hold()
    pair.out.resume(0, 1000, [])
    pair.sockets.publisher.release()
    assert pair.out.room == 1000
    pair.readers[0]._subscriber.send_up(ack_of("/p/word", "r", 1000))
    pair.wait_for_room(1000 + DEPTH)
    pair.publish(1)


def ack_of(topic: str, reader: str, sequence: int) -> bytes:
    return ACK + msgspec.msgpack.encode((topic, reader, 0, sequence, 0))


def test_every_loss_is_counted_at_both_ends_and_told_at_most_once_a_second(pair: Pair) -> None:
    reader = pair.reader(qos=Qos(depth=1))
    reported: list[int] = []
    backpressure, now_ns = pair.sockets.publisher.backpressure, monotonic_ns()
    skipped = 0
    for lost in (3, 4):
        pair.publish(1)
        pair.take(reader, pair.out.sequence)
        pair.out.sequence += lost  # published, and never sent
        pair.sockets.publisher.send_heartbeats()
        buffer = reader.buffers["/p/word"]
        while buffer.give_up_ns is None:
            reader.receive(SLICE_NS)
        buffer.expire(buffer.give_up_ns)
        skipped += lost
        while reader._executor.inbox:
            reader.deliver_next()
        pair.hear(lambda skipped=skipped: pair.out.lost_count >= skipped)  # type: ignore[misc]
        reported += [change for _, change in backpressure.newly_lost(now_ns)]
        assert pair.out.lost_count == skipped == pair.listeners[0].ends.accounts["/p/word"].lost
    assert reported == [3]
    assert backpressure.newly_lost(now_ns + REPORT_NS) == [(pair.out, 4)]
    assert not backpressure.newly_lost(now_ns + 2 * REPORT_NS)


def test_a_publishers_handler_hears_of_what_its_readers_have_lost(tmp_path: Path) -> None:
    pair = Pair(tmp_path, Heedful)
    pair.out.lost_count = 5
    pair.report_losses()
    pair.talker.run_timers()
    assert pair.talker.node.state.heard == [5]  # type: ignore[attr-defined]
    assert pair.talker.ends.counts()["lost_by_readers"] == 5
    pair.close()


def test_a_publisher_without_a_handler_says_it_in_its_log_and_on_its_events(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    pair.out.lost_count = 5
    before = pair.talker.ends.publishers["/p/_events"].sequence
    pair.report_losses()
    assert pair.talker.ends.publishers["/p/_events"].sequence == before + 1
    assert "output 'word' (/p/word): readers have lost messages for good" in caplog.text


def test_in_simulated_time_nobody_waits() -> None:
    out: Any = Drive(Generous, name="p").executor.ends.publishers["/p/word"]
    for n in range(3 * DEPTH):
        out.publish(Word(n=n))
    assert out.sequence == 3 * DEPTH
    assert out.room == LAST_SEQUENCE


@pytest.mark.parametrize(
    "event",
    [
        ACK,
        ACK + b"\xc1",
        ACK + b"\x95\xa7/p/word\xa1r\x00\xff\x00",
        ACK + b"\x91" * 3000,
        b"\x01" + FLOW_CONTROL,
        b"\x01" + FLOW_CONTROL + b"/p/word\0r\0nan\0x",
        b"\x01" + FLOW_CONTROL + b"/p/word\0r\x008\0nan",
        b"\x01" + FLOW_CONTROL + b"/p/word\0r\x008\0inf",
        b"\x01" + FLOW_CONTROL + b"/p/word\0r\0" + b"9" * 30 + b"\x0020.0",
        b"\x01" + FLOW_CONTROL + b"\xff\0\xff\0-1\0-1",
        b"\0" + FLOW_CONTROL + b"/p/word\0r\x008\x0020.0",
    ],
)
def test_a_strangers_words_do_no_harm(pair: Pair, event: bytes) -> None:
    with pair.sockets.context.socket(zmq.XSUB) as stranger:
        stranger.connect(pair.places[0])
        stranger.send(event)
        pair.reader()
    pair.publish(DEPTH)
    assert pair.out.room == DEPTH


def test_a_hold_is_read_as_it_was_said() -> None:
    hold = FlowControl("/p/word", "r", 7, 0.5)
    assert read_flow_control(hold.token()) == hold
    assert read_ack(ack_of("/p/word", "r", 3)) is not None
    assert read_ack(ACK + pack(b"/p/word", Kind.DATA, 0, 1, 0, schema_of(Word).type_hash)) is None


STUCK = """
import sys
from palp_core.graph.transport.acks import FlowControl
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
tokens = [FlowControl("/p/word", "r", 8, 20.0).token()]
reader = SubscriberSocket({"/p/word": sys.argv[1]}, name="r", flow_controls=tokens)
sys.stdin.read()
"""


def test_a_reader_that_is_killed_releases_its_publisher(pair: Pair) -> None:
    command = [sys.executable, "-c", STUCK, pair.places[0]]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        while pair.out.room == LAST_SEQUENCE:
            pair.sockets.poll()
        pair.publish(DEPTH)
        with pytest.raises(PublishTimeout):
            pair.publish(1)
        process.kill()
        pair.wait_for_room(LAST_SEQUENCE)
        pair.publish(1)


FLOOD = """
from palp_core import Alarm, Message, Node, Pub, Sub, on


class Letter(Message):
    index: int


class Source(Node):
    letter = Pub(Letter)
    done = Sub(Letter)
    begin = Alarm()

    def on_activate(self):
        self.begin.set(self.now_ns())

    @on(begin)
    def send(self):
        end, waits = self._context.ends.publishers["/source/letter"], []
        honest = end.wait_for_room
        end.wait_for_room = lambda: (waits.append(1), honest())
        for index in range(1, 2001):
            self.letter.publish(Letter(index=index))
        assert waits

    @on(done)
    def end(self, letter):
        account = self._context.ends.publishers["/source/letter"]
        self.finish(0 if (account.sequence, account.lost_count) == (2000, 0) else 3)


class Reader(Node):
    letter = Sub(Letter)
    done = Pub(Letter)

    @on(letter)
    def take(self, letter):
        sum(range(2000))
        account = self._context.ends.accounts["/source/letter"]
        if letter.index == 2000 and (account.received, account.lost) == (2000, 0):
            self.done.publish(letter)
"""
EDGE = """
graph: flood
clock: wall
nodes:
  source: {run: "nodes.flood:Source", inputs: {done: reader/done}, on_exit: shutdown}
  reader:
    run: nodes.flood:Reader
    inputs: {letter: {from: source/letter, history: keep_all, depth: 64, max_blocking_ms: 60000}}
"""


def test_a_flood_on_keep_all_loses_nothing_and_its_sender_waits(palp: Palp, tmp_path: Path) -> None:
    write_files(tmp_path, {"nodes/flood.py": FLOOD, "launch/flood.yaml": EDGE})
    palp.printed("launch", tmp_path / "launch/flood.yaml")
