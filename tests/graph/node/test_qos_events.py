"""Deadlines, lifespans, lost messages and unanswered calls, as a node hears of them."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from palp_core import Client, Message, Node, NodeEvent, Pub, Qos, QosEvent, State, Sub, on, on_event
from palp_core.errors import GraphError
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.frame import Kind, pack, parse
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.messages.qos import EventKind
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.node.subscription import FEW_REPEATS

MS = 1_000_000


class Word(Message):
    n: int


class Heard(State):
    log: list[str] = []


class Watcher(Node):
    state: Heard
    word = Sub(Word, qos=Qos(deadline_ms=10.0, lifespan_ms=50.0))
    ask = Client(Word, Word, timeout_ms=100.0, retries=2)
    out = Pub(Word)

    @on(word)
    def take(self, word: Word) -> None:
        self.state.log.append(f"word {word.n}")
        if word.n == 7:
            self.ask.call(word)

    @on(ask)
    def learn(self, word: Word) -> None:
        self.state.log.append(f"reply {word.n}")

    @on_event(word)
    def mind(self, event: QosEvent) -> None:
        self.state.log.append(f"{event.kind} {event.count_change} of {event.total_count}")

    @on_event(ask)
    def give_up(self, event: QosEvent) -> None:
        self.state.log.append(f"{event.kind} {event.total_count}")


class Drive:
    """A watcher on a clock that the test moves."""

    def __init__(self) -> None:
        self.clock = SimClock()
        self.frames: list[bytes] = []
        self.resent: list[bytes] = []
        spec = NodeSpec(name="w", run="m:W", inputs={"word": "/p/word", "ask": "/s/do"})
        self.executor = Executor(Watcher, spec, self.clock, self.frames.append)
        self.executor.resend = self.resent.append
        self.node: Any = self.executor.node
        self.executor.transition(Transition.CONFIGURE)
        self.executor.transition(Transition.ACTIVATE)

    def word(
        self, n: int, *, stamp_ns: int | None = None, topic: str = "/p/word", kind: int = Kind.DATA
    ) -> None:
        stamp = self.clock.now_ns() if stamp_ns is None else stamp_ns
        payload = encode(Word(n=n))
        self.executor.consume(pack(topic.encode(), kind, 0, n, stamp, schema_of(Word).type_hash, payload))
        self.executor.run_timers()

    def wait(self, duration_ns: int) -> None:
        end_ns = self.clock.now_ns() + duration_ns
        while (due_ns := self.executor.next_due_ns()) is not None and due_ns <= end_ns:
            self.clock.set(max(due_ns, self.clock.now_ns()))
            self.executor.run_timers()
        self.clock.set(end_ns)

    @property
    def log(self) -> list[str]:
        log: list[str] = self.node.state.log
        return log

    def said(self) -> list[str]:
        frames = [parse(frame) for frame in self.frames]
        return [decode(NodeEvent, f.payload).kind for f in frames if f.topic == "/w/_events"]


def test_a_deadline_counts_from_the_first_message_and_again_each_period() -> None:
    drive = Drive()
    drive.wait(100 * MS)
    assert drive.log == []
    drive.word(1)
    drive.wait(25 * MS)
    assert drive.log == ["word 1", "deadline 1 of 1", "deadline 1 of 2"]
    drive.word(2)
    drive.wait(9 * MS)
    assert drive.log[3:] == ["word 2"]


def test_a_stopped_process_counts_the_deadlines_it_slept_through_at_once() -> None:
    drive = Drive()
    drive.word(1)
    drive.clock.set(drive.clock.now_ns() + 1000 * MS)
    drive.executor.run_timers()
    assert drive.log == ["word 1", "deadline 100 of 100"]


def test_a_publisher_that_says_idle_suspends_the_deadline_until_it_publishes_again() -> None:
    drive = Drive()
    drive.word(1)
    drive.word(1, kind=Kind.IDLE)
    drive.wait(100 * MS)
    assert drive.log == ["word 1"]
    drive.word(2)
    drive.wait(10 * MS)
    assert drive.log[1:] == ["word 2", "deadline 1 of 1"]


def test_idle_is_said_once_and_ends_with_the_next_message() -> None:
    drive = Drive()
    out: Any = drive.node.out
    for _ in range(2):
        out.idle()
    out.publish(Word(n=1))
    frames = [f for f in map(parse, drive.frames) if f.topic == "/w/out"]
    assert [f.kind for f in frames] == [Kind.IDLE, Kind.DATA]
    assert parse(out.heartbeat()).kind == Kind.HEARTBEAT


def test_a_message_past_its_lifespan_is_dropped_counted_and_told() -> None:
    drive = Drive()
    drive.wait(100 * MS)
    drive.word(1, stamp_ns=49 * MS)
    drive.word(2, stamp_ns=50 * MS)
    counter = drive.executor.ends.accounts["/p/word"]
    assert (counter.received, counter.dropped, counter.late, counter.lost) == (1, 1, 2, 0)
    assert drive.log == ["lifespan 1 of 1", "word 2"]


def test_lost_messages_are_told_with_their_number() -> None:
    drive = Drive()
    drive.word(1)
    drive.word(5)
    assert drive.log == ["word 1", "word 5", "message_lost 3 of 3"]
    assert drive.said() == ["transition", "message_lost"]


def test_a_call_is_asked_again_and_then_given_up() -> None:
    drive = Drive()
    drive.word(7)
    drive.word(7, kind=Kind.IDLE)
    requests = [f for f in drive.frames if parse(f).topic == "/w/ask"]
    drive.wait(299 * MS)
    assert drive.resent == requests * 2
    drive.wait(1 * MS)
    assert drive.log == ["word 7", "call_timeout 1"]
    drive.word(1, topic="/s/do/w/ask")
    assert drive.executor.ends.accounts["/s/do/w/ask"].repeated == 1


def test_a_reply_settles_its_own_call_in_whatever_order_it_comes() -> None:
    drive = Drive()
    drive.word(7)
    drive.executor.ends.accounts["/p/word"].sequence = 6
    drive.word(7)
    drive.word(7, kind=Kind.IDLE)
    drive.word(2, topic="/s/do/w/ask")
    drive.word(1, topic="/s/do/w/ask")
    drive.word(1, topic="/s/do/w/ask")
    drive.wait(1000 * MS)
    assert drive.log == ["word 7", "word 7", "reply 2", "reply 1"]
    assert drive.resent == []


def test_events_of_a_port_of_another_class_are_refused() -> None:
    with pytest.raises(GraphError, match="not declared here"):

        class Wrong(Node):
            @on_event(Watcher.word)
            def mind(self, event: QosEvent) -> None: ...


def test_events_and_calls_survive_a_hand_over() -> None:
    drive, heir = Drive(), Drive()
    drive.word(1)
    drive.word(5)
    drive.word(7)
    drive.executor.pause()
    heir.executor = Executor(Watcher, drive.executor.spec, drive.clock, heir.frames.append)
    heir.clock, heir.node = drive.clock, heir.executor.node
    heir.executor.resend = heir.resent.append
    heir.executor.transition(Transition.CONFIGURE)
    heir.executor.take_over(drive.executor.hand_over())
    heir.word(7, kind=Kind.IDLE)
    heir.word(9)
    heir.word(9, kind=Kind.IDLE)
    heir.wait(300 * MS)
    assert heir.log[-3:] == ["word 9", "message_lost 1 of 5", "call_timeout 1"]
    assert len(heir.resent) == 2


@pytest.mark.parametrize("kind", get_args(EventKind))
def test_each_kind_of_event_has_its_words(kind: EventKind) -> None:
    event = QosEvent(kind=kind, port="load", topic="/sensor/load", total_count=3, count_change=1)
    assert event.text.split(" ")[0] in ("input", "output", "client")
    assert " 'load' (/sensor/load): " in event.text


def test_a_reader_that_drops_one_repeat_after_the_other_says_so_and_a_few_are_no_news() -> None:
    drive = Drive()
    drive.word(100)
    for n in range(1, FEW_REPEATS):
        drive.word(n)
    drive.word(101)
    drive.word(101)
    assert "message_repeated" not in drive.said()
    for n in range(1, 100):
        drive.word(n)
    assert drive.said().count("message_repeated") == 4  # the 8th, 16th, 32nd and 64th
    assert drive.executor.ends.accounts["/p/word"].repeated == FEW_REPEATS + 99
    assert drive.log == ["word 100", "word 101"]
