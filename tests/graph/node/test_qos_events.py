"""Deadlines, lifespans, lost messages and unanswered calls, as a node hears of them."""

from typing import Any, get_args

import pytest

from palp_core import Client, Message, Node, NodeEvent, Pub, Qos, QosEvent, State, Sub, on, on_event
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.qos import EventKind
from palp_core.graph.node.subscription import FEW_REPEATS
from tests.support.drive import MS, Drive


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


class Watched(Drive):
    """A watcher, its input and what it has reported."""

    def __init__(self) -> None:
        super().__init__(Watcher, name="w", inputs={"word": "/p/word", "ask": "/s/do"})

    def word(
        self, n: int, *, stamp_ns: int | None = None, topic: str = "/p/word", kind: int = Kind.DATA
    ) -> None:
        self.consume(topic, Word(n=n), n, kind=kind, stamp_ns=stamp_ns)
        self.executor.run_timers()

    @property
    def log(self) -> list[str]:
        log: list[str] = self.node.state.log
        return log

    def reported(self) -> list[str]:
        return [event.kind for event in self.sent("/w/_events", NodeEvent)]


@pytest.mark.parametrize(
    ("deeds", "log"),
    [
        pytest.param(
            ["wait 100", "word 1", "wait 25", "word 2", "wait 9"],
            ["word 1", "deadline 1 of 1", "deadline 1 of 2", "word 2"],
            id="a deadline counts from the first message and again each period",
        ),
        pytest.param(
            ["word 1", "sleep 1000"],
            ["word 1", "deadline 100 of 100"],
            id="a stopped process counts the deadlines it slept through at once",
        ),
        pytest.param(
            ["word 1", "idle 1", "wait 100", "word 2", "wait 10"],
            ["word 1", "word 2", "deadline 1 of 1"],
            id="a publisher that is idle suspends the deadline until it publishes again",
        ),
        pytest.param(
            ["wait 100", "word 1 49", "word 2 50"],
            ["lifespan 1 of 1", "word 2"],
            id="a message past its lifespan is dropped",
        ),
        pytest.param(
            ["word 1", "word 5"],
            ["word 1", "word 5", "message_lost 3 of 3"],
            id="lost messages are told with their number",
        ),
        pytest.param(
            ["word 7", "idle 7", "wait 300"],
            ["word 7", "call_timeout 1"],
            id="a call is asked again and then given up",
        ),
        pytest.param(
            ["word 7", "back 6", "word 7", "idle 7", "reply 2", "reply 1", "reply 1", "wait 1000"],
            ["word 7", "word 7", "reply 2", "reply 1"],
            id="a reply settles its own call in whatever order it comes",
        ),
    ],
)
def test_what_an_edge_does_not_keep_is_told(deeds: list[str], log: list[str]) -> None:
    drive = Watched()
    for deed in deeds:
        verb, number, *stamp = deed.split()
        stamp_ns = int(stamp[0]) * MS if stamp else None
        if verb == "wait":
            drive.wait(int(number) * MS)
        elif verb == "sleep":
            drive.clock.set(drive.clock.now_ns() + int(number) * MS)
            drive.executor.run_timers()
        elif verb == "back":
            drive.executor.ends.accounts["/p/word"].sequence = int(number)
        elif verb == "reply":
            drive.word(int(number), topic="/s/do/w/ask")
        else:
            drive.word(int(number), stamp_ns=stamp_ns, kind=Kind.IDLE if verb == "idle" else Kind.DATA)
    assert drive.log == log


def test_a_message_past_its_lifespan_and_a_lost_one_are_in_the_account() -> None:
    drive = Watched()
    drive.wait(100 * MS)
    drive.word(1, stamp_ns=49 * MS)
    drive.word(2, stamp_ns=50 * MS)
    drive.word(5)
    counter = drive.executor.ends.accounts["/p/word"]
    assert (counter.received, counter.dropped, counter.late, counter.lost) == (2, 1, 2, 2)
    assert drive.reported() == ["transition", "lifespan", "message_lost"]


def test_a_call_is_asked_again_with_the_same_bytes_and_a_late_reply_is_a_repeat() -> None:
    drive = Watched()
    drive.word(7)
    drive.word(7, kind=Kind.IDLE)
    drive.wait(300 * MS)
    assert drive.resent == [f for f in drive.frames if parse(f).topic == "/w/ask"] * 2
    drive.word(1, topic="/s/do/w/ask")
    assert drive.executor.ends.accounts["/s/do/w/ask"].repeated == 1


def test_idle_is_said_once_and_ends_with_the_next_message() -> None:
    drive = Watched()
    out: Any = drive.node.out
    for _ in range(2):
        out.idle()
    out.publish(Word(n=1))
    frames = [f for f in map(parse, drive.frames) if f.topic == "/w/out"]
    assert [f.kind for f in frames] == [Kind.IDLE, Kind.DATA]
    assert parse(out.heartbeat()).kind == Kind.HEARTBEAT


def test_events_and_calls_survive_a_hand_over() -> None:
    drive = Watched()
    for n in (1, 5, 7):
        drive.word(n)
    drive.executor.pause()
    heir = drive.configured(Watcher)
    heir.take_over(drive.executor.hand_over())
    drive.executor = heir
    drive.word(7, kind=Kind.IDLE)
    drive.word(9)
    drive.word(9, kind=Kind.IDLE)
    drive.wait(300 * MS)
    assert drive.log[-3:] == ["word 9", "message_lost 1 of 5", "call_timeout 1"]
    assert len(drive.resent) == 2


@pytest.mark.parametrize("kind", get_args(EventKind))
def test_each_kind_of_event_has_its_words(kind: EventKind) -> None:
    event = QosEvent(kind=kind, port="load", topic="/sensor/load", total_count=3, count_change=1)
    assert event.text.split(" ")[0] in ("input", "output", "client")
    assert " 'load' (/sensor/load): " in event.text


def test_a_reader_that_drops_one_repeat_after_the_other_says_so_and_a_few_are_no_news() -> None:
    drive = Watched()
    drive.word(100)
    for n in range(1, FEW_REPEATS):
        drive.word(n)
    drive.word(101)
    drive.word(101)
    assert "message_repeated" not in drive.reported()
    for n in range(1, 100):
        drive.word(n)
    assert drive.reported().count("message_repeated") == 4  # the 8th, 16th, 32nd and 64th
    assert drive.executor.ends.accounts["/p/word"].repeated == FEW_REPEATS + 99
    assert drive.log == ["word 100", "word 101"]
