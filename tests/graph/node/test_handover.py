"""A node continues in another executor, or from its own written order, as if nothing had happened."""

import json
from typing import Any, Self

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import LifecycleError, SchemaMismatch
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import Message, decode, decode_any, encode_any
from palp_core.graph.node.bench import Bench
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver, Predecessor, adopt_state
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.node import Node, Params, State
from palp_core.graph.node.ports import Alarm, Client, Pub, Srv, Sub, Timer, every, on, serve
from palp_core.graph.node.spec import NodeSpec
from palp_core.units import Float64Array, Hertz, RatioArray, Seconds
from tests.support.drive import MS, Drive


class Word(Message):
    n: int
    values: RatioArray = np.zeros(0)


class Answer(Message):
    n: float
    drawn: float = 0.0


class BusyParams(Params):
    slow_hz: Hertz = 3.0
    fast_hz: Hertz = 70.0
    pause_s: Seconds = 0.0123


class BusyState(State):
    total: float = 0
    last: list[Word] = []
    weights: Float64Array = np.zeros(3)
    replies: dict[str, float] = {}
    rung: int = 0


class Busy(Node):
    """Uses inputs, a service, a client, timers, an alarm, randomness and arrays in its state."""

    params: BusyParams
    state: BusyState
    left = Sub(Word)
    right = Sub(Word)
    out = Pub(Answer)
    ask = Client(Word, Answer)
    sum_up = Srv(Word, Answer)
    fast = Timer("fast_hz")
    alarm = Alarm()

    def on_activate(self) -> None:
        self.state.weights = np.zeros(3)
        self.out.publish(Answer(n=-1.0, drawn=self.rng.normal()))

    @on(left)
    def take_left(self, word: Word) -> None:
        self.state.total += word.n
        self.state.last = [*self.state.last, word][-3:]
        self.state.weights[word.n % 3] += word.values.sum()
        self.alarm.set(self.now_ns() + round(self.params.pause_s * 1e9))

    @on(right)
    def take_right(self, word: Word) -> None:
        if word.n % 2:
            self.fast.start()
        else:
            self.fast.stop()
        if word.n % 5 == 0:
            self.alarm.clear()
        self.ask.call(Word(n=word.n))

    @on(ask)
    def learn(self, answer: Answer) -> None:
        self.state.replies = {**self.state.replies, str(int(answer.n)): answer.drawn}

    @serve(sum_up)
    def total_of(self, request: Word) -> Answer:
        return Answer(n=self.state.total, drawn=float(self.rng.integers(100)))

    @every("slow_hz")
    def report(self) -> None:
        mean = sum(float(w.values.sum()) for w in self.state.last)
        self.out.publish(Answer(n=mean + self.state.weights[0], drawn=self.rng.random()))

    @on(fast)
    def hurry(self) -> None:
        self.out.publish(Answer(n=self.state.total, drawn=self.rng.random(dtype=np.float32)))

    @on(alarm)
    def ring(self) -> None:
        self.state.rung += 1
        self.out.publish(Answer(n=self.state.rung, drawn=sum(self.state.replies.values())))


SPEC = NodeSpec(
    name="busy",
    run=f"{__name__}:Busy",
    inputs={"left": "/w/left", "right": "/w/right", "ask": "/w/srv"},
    requests={"sum_up": ["/one/c", "/two/c"]},
    seed=5,
    epoch=2,
)
TYPES: dict[str, type[Message]] = {
    "/w/left": Word,
    "/w/right": Word,
    "/w/srv/busy/ask": Answer,
    "/one/c": Word,
    "/two/c": Word,
}
Step = tuple[str, int, int]
"""A topic to feed (or ``wait`` or ``params``), a number, and milliseconds to wait before."""

steps = st.lists(
    st.tuples(st.sampled_from([*TYPES, "wait", "params"]), st.integers(0, 9), st.integers(0, 60)), max_size=30
)


def _message(topic: str, n: int) -> Message:
    if TYPES[topic] is Answer:
        return Answer(n=n, drawn=n / 7)
    return Word(n=n, values=np.linspace(0.0, 1.0, n))


class Run(Drive):
    """Remembers what was consumed and what came out, through changes of executor."""

    def __init__(self) -> None:
        super().__init__(Busy, **msgspec.structs.asdict(SPEC))
        self.node_class: type[Node] = Busy
        self.fed: dict[tuple[str, int], bytes] = {}
        self.sequence: dict[str, int] = {}

    def swap(self, *, waiting: list[Step] | None = None) -> HandOver:
        """Let another executor take over, through bytes."""
        self.executor.pause()
        for topic, n, _ in waiting or []:
            self.feed(topic, n)
        hand_over = decode_any(HandOver, encode_any(self.executor.hand_over()))
        self.executor = self.configured(self.node_class)
        self.executor.take_over(hand_over)
        while self.executor.inbox:
            self.executor.consume(self.executor.inbox.popleft())
        return hand_over

    def feed(self, topic: str, n: int) -> None:
        sequence = self.sequence[topic] = self.sequence.get(topic, 0) + 1
        self.fed[topic, sequence] = self.consume(topic, _message(topic, n), sequence)

    def step(self, step: Step) -> None:
        what, n, ms = step
        self.wait(ms * MS)
        if what == "params":
            self.executor.set_parameters({"pause_s": 0.001 * n})
        elif what != "wait":
            self.feed(what, n)

    def outputs(self) -> list[bytes]:
        return [frame for frame in self.frames if parse(frame).topic not in ("/busy/_order", "/busy/_events")]

    def orders(self) -> list[Order]:
        self.executor.transition(Transition.DEACTIVATE)
        return self.sent("/busy/_order", Order)


def _straight(script: list[Step]) -> Run:
    run = Run()
    for step in script:
        run.step(step)
    run.wait(500 * MS)
    return run


@given(steps, st.sets(st.integers(0, 30), max_size=4))
def test_a_hand_over_at_any_point_changes_no_byte_of_the_output(script: list[Step], swaps: set[int]) -> None:
    run = Run()
    pause_s = SPEC.params.get("pause_s", 0.0123)
    for index, step in enumerate(script):
        if index in swaps:
            run.swap()
            run.executor.set_parameters({"pause_s": pause_s})
        run.step(step)
        pause_s = run.executor.node.params.pause_s  # type: ignore[attr-defined]
    run.swap()
    run.executor.set_parameters({"pause_s": pause_s})
    run.wait(500 * MS)
    straight = _straight(script)
    assert run.outputs() == straight.outputs()
    assert encode_any(run.executor.node.state) == encode_any(
        decode_any(BusyState, encode_any(straight.executor.node.state))
    )
    assert run.executor.ends.accounts == straight.executor.ends.accounts
    for name, out in run.executor.ends.publishers.items():
        if not name.startswith("/busy/_"):
            assert list(out.history) == [f for f in run.frames if parse(f).topic == name][-out.qos.depth :]


@settings(max_examples=20)
@given(steps, st.integers(1, 5))
def test_what_waits_in_the_inbox_moves_with_the_node(script: list[Step], last: int) -> None:
    script = [(topic, n, 0) for topic, n, _ in script if topic in TYPES]
    straight, moved = Run(), Run()
    for step in script:
        straight.step(step)
    for step in script[:-last]:
        moved.step(step)
    hand_over = moved.swap(waiting=script[-last:])
    assert len(hand_over.inbox) == min(last, len(script))
    assert moved.outputs() == straight.outputs()


def _redrive(orders: list[Order], fed: dict[tuple[str, int], bytes], start: int) -> list[bytes]:
    """Drive a fresh node from what another wrote down, from the batch ``start`` on."""
    frames: list[bytes] = []
    clock = SimClock()
    executor = Executor(Busy, SPEC, clock, frames.append)
    executor.transition(Transition.CONFIGURE)
    topics = {"input:left": "/w/left", "input:right": "/w/right", "reply:ask": "/w/srv/busy/ask"}
    if orders[start].hand_over:
        executor.take_over(decode_any(HandOver, orders[start].hand_over))
    for order in orders[start:]:
        for source, sequence, now_ns in zip(order.source, order.sequence, order.now_ns, strict=True):
            name = order.sources[source]
            clock.set(now_ns)
            if name in list(Transition):
                executor.transition(Transition(name))
            elif name == "parameters":
                executor.set_parameters(json.loads(order.changes[sequence]))
            elif name.startswith("timer:"):
                assert executor.run_timer(name.removeprefix("timer:")) == sequence
            else:
                topic = topics.get(name) or name.removeprefix("call:sum_up")
                executor.consume(fed[topic, sequence])
    return [frame for frame in frames if parse(frame).topic not in ("/busy/_order", "/busy/_events")]


@given(steps)
def test_the_written_order_is_enough_to_drive_the_node_again_to_the_same_bytes(script: list[Step]) -> None:
    run = _straight(script)
    orders = run.orders()
    assert _redrive(orders, run.fed, 0) == run.outputs()


def test_the_order_is_written_in_batches_with_a_state_every_ten_seconds() -> None:
    run = Run()
    run.step(("/w/right", 1, 0))
    run.wait(25_000 * MS)
    orders = run.orders()
    starts = [index for index, order in enumerate(orders) if order.hand_over]
    assert [orders[index].now_ns[0] // 10**10 for index in starts] == [1, 2]
    assert all(len(order.source) <= 256 for order in orders)
    ticks = [
        s for o in orders for n, s in zip(o.source, o.sequence, strict=True) if o.sources[n] == "timer:fast"
    ]
    assert ticks == list(range(1, 1750 + 1))
    assert _redrive(orders, run.fed, 0) == run.outputs()
    for start in starts:
        again = _redrive(orders, run.fed, start)
        assert again
        assert again == run.outputs()[-len(again) :]


def test_a_node_that_fails_leaves_the_order_that_led_there() -> None:
    class Fragile(Node):
        word = Sub(Word)

        @on(word)
        def fail(self, word: Word) -> None:
            if word.n == 3:
                raise ValueError("three")

    bench = Bench(Fragile)
    with pytest.raises(Exception, match="three"):
        bench.feed(Fragile.word, *[Word(n=n) for n in range(5)])
    assert [order.sequence for order in bench.orders()] == [[0, 1, 2, 3, 4]]


def test_only_an_inactive_node_can_take_over() -> None:
    run = Run()
    with pytest.raises(LifecycleError):
        run.executor.take_over(run.executor.hand_over())


class OldState(State):
    window: list[float] = []


class NewState(State):
    version = 2
    mean: float = 0.0

    @classmethod
    def migrate(cls, old: Predecessor) -> Self:
        if old.version != 1:
            raise SchemaMismatch(f"version {old.version} is not known")
        return cls(mean=float(np.mean(old.values["window"])))

    @classmethod
    def adopt(cls, old: Predecessor) -> Self:
        return cls(mean=old.values.get("total", -1.0))


class Lenient(State):
    @classmethod
    def adopt(cls, old: Predecessor) -> Any:
        return old.values


class Renamed(State):
    renamed: list[float] = []


def _hand_over(state: State, node_class: str = "m:C", version: int = 1, state_class: str = "") -> HandOver:
    return msgspec.structs.replace(
        Run().executor.hand_over(),
        state=encode_any(state),
        node_class=node_class,
        state_version=version,
        state_class=f"{__name__}:{state_class}",
    )


OLD = OldState(window=[1.0, 2.0])


@pytest.mark.parametrize(
    ("kept", "expected"),
    [
        pytest.param(_hand_over(OLD), NewState(mean=1.5), id="an older version is migrated"),
        pytest.param(_hand_over(BusyState(total=4.0), "m:D"), NewState(mean=4.0), id="another is adopted"),
        pytest.param(_hand_over(NewState(mean=2.0), version=2), NewState(mean=2.0), id="the same is decoded"),
        pytest.param(_hand_over(OLD, "m:D", 1, "OldState"), OLD, id="one of its own type is decoded"),
    ],
)
def test_a_state_is_taken_over(kept: HandOver, expected: State) -> None:
    assert adopt_state(type(expected), "m:C", kept) == expected


@pytest.mark.parametrize(
    ("state_class", "kept", "why"),
    [
        (OldState, _hand_over(OLD, "m:D"), "OldState cannot take the state of m:D: define adopt"),
        (OldState, _hand_over(OLD, "m:D", 1, "NewState"), "define adopt"),
        (OldState, _hand_over(OLD, "m:D", 7, "OldState"), "define adopt"),
        (OldState, _hand_over(OLD, version=7), r"define migrate \(from version 7\)"),
        (NewState, _hand_over(OLD, version=7), "version 7 is not known"),
        (Lenient, _hand_over(OLD, "m:D"), r"Lenient\.adopt returned dict"),
        (Renamed, _hand_over(OLD), "window"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_not_forgotten(
    state_class: type[State], kept: HandOver, why: str
) -> None:
    with pytest.raises(SchemaMismatch, match=why):
        adopt_state(state_class, "m:C", kept)


class ThirdState(State):
    adopted: float = 0.0

    @classmethod
    def adopt(cls, old: Predecessor) -> Self:
        return cls(adopted=old.values["total"])


class Successor(Node):
    """Another class with the same ports, another rate and a timer of its own."""

    params: BusyParams
    state: ThirdState
    left = Sub(Word)
    right = Sub(Word)
    out = Pub(Answer)

    @on(left)
    def take_left(self, word: Word) -> None: ...

    @on(right)
    def take_right(self, word: Word) -> None: ...

    @every("fast_hz")
    def own(self) -> None:
        self.out.publish(Answer(n=self.state.adopted))


def test_another_class_takes_over_with_its_own_timers_running() -> None:
    run = Run()
    run.step(("/w/left", 4, 999))
    count = len(run.outputs())
    run.node_class = Successor
    run.swap()
    run.wait(1000 * MS)
    assert len(run.outputs()) - count == 70
    assert decode(Answer, parse(run.outputs()[-1]).payload).n == 4.0


def test_a_refused_hand_over_leaves_the_successor_inactive() -> None:
    run = Run()
    successor = run.configured(Successor)
    with pytest.raises(SchemaMismatch):
        successor.take_over(msgspec.structs.replace(run.executor.hand_over(), state=b"\xc1"))
    assert successor.lifecycle.value == "inactive"


class Total(State):
    total: int = 0

    @classmethod
    def adopt(cls, old: object) -> Self:
        return cls(total=old.values["total"])  # type: ignore[attr-defined]


class Rates(Params):
    rate_hz: float = 10.0


class Full(Node):
    params: Rates
    state: Total
    number = Sub(Word)
    out = Pub(Word)
    other = Pub(Word)
    timer = Timer("rate_hz", running=False)
    alarm = Alarm()

    def on_activate(self) -> None:
        self.timer.start()
        self.alarm.set(8_000_000_000)
        self.other.publish(Word(n=1))

    @on(number)
    def take(self, number: Word) -> None:
        self.state.total += number.n

    @on(timer)
    def tick(self) -> None: ...

    @on(alarm)
    def ring(self) -> None: ...


class Thin(Node):
    state: Total
    number = Sub(Word)
    out = Pub(Word)

    @on(number)
    def take(self, number: Word) -> None:
        self.state.total += 10 * number.n
        self.out.publish(number)


def test_what_only_the_old_class_has_is_as_it_was() -> None:
    drive = Drive(Full, name="relay", inputs={"number": "/source/out"})
    old, new = drive.executor, drive.configured(Thin)
    before = old.ends.write_down()
    old.pause()
    new.take_over(old.hand_over())
    new.node.take(Word(n=3))  # type: ignore[attr-defined]
    old.take_back(new.full_snapshot(), list(new.ends.timed))
    after = old.ends.write_down()
    assert old.node.state == Total(total=30)
    assert after["alarms"] == before["alarms"] == {"alarm": 8_000_000_000}
    assert after["timers"] == before["timers"]
    assert after["published"]["/relay/other"] == before["published"]["/relay/other"] == 1
    assert after["published"]["/relay/out"] == before["published"]["/relay/out"] + 1
    assert old.is_active
    assert not old.paused
