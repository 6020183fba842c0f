"""The bench: a node in memory, fed by hand on a clock that moves when told."""

import contextlib

import pytest

from palp_core import Alarm, Bench, Client, Message, Node, Params, Pub, Srv, State, Sub, every, on, serve
from palp_core.errors import NodeError
from palp_core.units import HertzPositive, Seconds


class Word(Message):
    n: int


class EchoParams(Params):
    hz: HertzPositive = 10.0
    delay_s: Seconds = 0.25
    restless: bool = False


class EchoState(State):
    last: int = 0


class Echo(Node):
    params: EchoParams
    state: EchoState
    word = Sub(Word)
    out = Pub(Word)
    late = Pub(Word)
    bell = Alarm()
    ask = Client(Word, Word)
    add = Srv(Word, Word)

    @on(word)
    def take(self, word: Word) -> None:
        self.state.last = word.n
        with contextlib.suppress(OverflowError, TypeError):
            self.out.publish(Word(n=word.n << 64))
        with contextlib.suppress(TypeError):
            self.out.publish(Message())  # type: ignore[arg-type]
        self.out.publish(word)
        self.ask.call(word)
        self.bell.set(self.now_ns() + round(self.params.delay_s * 1e9))

    @on(bell)
    def ring(self) -> None:
        self.late.publish(Word(n=self.now_ns()))
        if self.params.restless:
            self.bell.set(self.now_ns())

    @on(ask)
    def learn(self, reply: Word) -> None:
        self.state.last += reply.n

    @serve(add)
    def add_up(self, request: Word) -> Word:
        return Word(n=self.state.last + request.n)

    @every("hz")
    def tick(self) -> None:
        self.out.publish(Word(n=-1))


def test_what_is_fed_is_handled_at_once_and_what_cannot_be_said_leaves_no_gap() -> None:
    bench = Bench(Echo)
    bench.feed(Echo.word, Word(n=1), Word(n=2))
    assert bench.sent(Echo.out) == [Word(n=1), Word(n=2)]
    assert bench.executor.ends.publishers["/node/out"].sequence == 2
    assert bench.requests(Echo.ask) == [Word(n=1), Word(n=2)]
    assert bench.node.state.last == 2


def test_time_moves_through_every_timer_and_alarm_on_its_way_and_not_back() -> None:
    bench = Bench(Echo, {"hz": 4.0, "delay_s": 0.3})
    bench.feed(Echo.word, Word(n=1))
    bench.advance(1.0)
    assert bench.sent(Echo.out) == [Word(n=1), *[Word(n=-1)] * 4]
    assert bench.sent(Echo.late) == [Word(n=300_000_000)]
    assert bench.clock.now_ns() == 1_000_000_000
    bench.advance_to(1_000_000_000)
    assert len(bench.sent(Echo.out)) == 5
    with pytest.raises(ValueError, match="back"):
        bench.advance(-0.1)


def test_an_alarm_for_now_rings_before_the_next_message_and_one_that_sets_itself_is_an_error() -> None:
    bench = Bench(Echo, {"delay_s": 0.0})
    bench.feed(Echo.word, Word(n=1), Word(n=2))
    assert bench.sent(Echo.late) == [Word(n=0), Word(n=0)]
    with pytest.raises(NodeError, match="1000 times at one instant"):
        Bench(Echo, {"delay_s": 0.0, "restless": True}).feed(Echo.word, Word(n=1))


def test_services_and_replies_work_by_hand() -> None:
    bench = Bench(Echo)
    bench.reply(Echo.ask, Word(n=5))
    assert bench.call(Echo.add, Word(n=2)) == Word(n=7)
    assert bench.call(Echo.add, Word(n=3)) == Word(n=8)
