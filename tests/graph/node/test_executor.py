"""One handler at a time: order, accounts, failures, services, parameters."""

import logging
from typing import Any

import numpy as np
import pytest

from palp_core import Alarm, Client, Message, Node, Params, Pub, Srv, State, Sub, Timer, every, on, serve
from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle, Transition
from palp_core.graph.node.spec import NodeSpec
from palp_core.units import Float64Array, Hertz, Metres
from tests.support.drive import Drive


class Word(Message):
    n: int
    x_m: Metres = 0.0


class Other(Message):
    n: int


class LogState(State):
    log: list[str] = []


class Rates(Params):
    a_hz: Hertz = 10.0
    b_hz: Hertz = 5.0
    name: str = "x"


class Everything(Node):
    params: Rates
    state: LogState
    word = Sub(Word)
    second = Timer("b_hz", running=True)
    bell = Alarm()
    out = Pub(Word)
    ask = Client(Word, Other)

    @every("a_hz")
    def zz_first(self) -> None:
        self.state.log.append("first")

    @on(second)
    def aa_second(self) -> None:
        self.state.log.append("second")

    @on(bell)
    def ring(self) -> None:
        self.state.log.append("bell")

    @on(word)
    def take(self, word: Word) -> None:
        self.state.log.append(f"word {word.n} of {self.params.name}")
        if word.n < 0:
            raise ValueError("below 0")
        self.bell.set(self.now_ns())

    @on(ask)
    def learn(self, reply: Other) -> None:
        self.state.log.append(f"learnt {reply.n}")

    def on_error(self, error: Exception) -> None:
        self.state.log.append(f"error {error}")

    def on_deactivate(self) -> None:
        self.state.log.append("deactivate")
        self.out.publish(Word(n=0))


WIRED: dict[str, Any] = {"inputs": {"word": "/p/word"}}


def test_due_timers_run_once_each_in_the_order_of_their_handlers() -> None:
    drive = Drive(Everything, **WIRED)
    drive.consume("/p/word", Word(n=1))
    drive.clock.set(200_000_000)
    drive.executor.run_timers()
    assert drive.node.state.log == ["word 1 of x", "first", "second", "bell"]
    assert drive.executor.next_due_ns() == 200_000_000
    drive.executor.run_timers()
    assert drive.node.state.log[4:] == ["first"]
    assert drive.executor.next_due_ns() == 300_000_000


def test_time_stands_still_within_a_handler() -> None:
    class Asking(Node):
        word = Sub(Word)
        out = Pub(Word)

        @on(word)
        def take(self, word: Word) -> None:
            before = self.now_ns()
            drive.clock.set(before + 5)
            self.out.publish(Word(n=self.now_ns() - before))

    drive = Drive(Asking, **WIRED)
    drive.consume("/p/word", Word(n=1))
    assert drive.sent("/n/out", Word) == [Word(n=0)]


def test_parameters_are_replaced_as_a_whole_or_not_at_all_and_swallow_no_tick() -> None:
    drive = Drive(Everything, **WIRED)
    before = drive.node.params
    drive.clock.set(100_000_000)
    drive.executor.set_parameters({"name": "y"})
    drive.executor.run_timers()
    assert drive.node.state.log == ["first"]  # it was due at the instant of the change
    drive.executor.set_parameters({"a_hz": 20.0})
    assert (drive.node.params, before) == (Rates(name="y", a_hz=20.0), Rates())
    assert drive.executor.next_due_ns() == 150_000_000
    refused: list[dict[str, Any]] = [{"name": "z", "a_hz": value} for value in (-1.0, 0.0, float("nan"))]
    for bad in [*refused, {"name": 3}, {"nam": "z"}]:
        with pytest.raises(GraphError, match="n: parameters"):
            drive.executor.set_parameters(bad)
        assert drive.node.params == Rates(name="y", a_hz=20.0)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -1.0, 1e10, 5e-324])
def test_a_rate_at_which_nothing_can_tick_is_refused_at_the_start(value: float) -> None:
    class Loose(Params):
        a_hz: float = 1.0

    ticking = type(
        "Ticking", (Node,), {"__annotations__": {"params": Loose}, "tick": every("a_hz")(lambda self: None)}
    )
    with pytest.raises(GraphError, match="'a_hz'"):
        Drive(ticking, params={"a_hz": value})


def test_bad_frames_are_counted_and_logged_but_harm_nothing(caplog: pytest.LogCaptureFixture) -> None:
    drive = Drive(Everything, **WIRED)
    hash_ = schema_of(Word).type_hash
    bad = [
        b"",
        b"garbage",
        pack(b"/p/word", Kind.DATA, 0, 1, 0, hash_, b"\xc1"),
        pack(b"/p/word", Kind.DATA, 0, 1, 0, hash_, b"\x81\xa1n\xa1\xff"),
        pack(b"/p/word", Kind.DATA, 0, 0, 0, hash_, encode(Word(n=1))),
        pack(b"/p/word", Kind.DATA, 0, 1, 0, hash_, encode(Word(n=1, x_m=float("nan")))),
        pack(b"/p/word", Kind.DATA, 0, 1, 0, hash_ ^ 1, encode(Word(n=1))),
        pack(b"/p/other", Kind.DATA, 0, 1, 0, hash_, encode(Word(n=1))),
    ]
    with caplog.at_level(logging.WARNING):
        for frame in bad:
            drive.executor.consume(frame)
    assert drive.executor.events.rejected_count == len(bad)
    assert drive.node.state.log == []
    assert len(caplog.records) == 4
    assert any("topic /p/word, input " in one.message for one in caplog.records)
    drive.consume("/p/word", Word(n=5))
    assert drive.node.state.log == ["word 5 of x"]


def test_a_handler_that_raises_names_itself_and_brings_the_node_to_its_safe_state() -> None:
    drive = Drive(Everything, **WIRED)
    with pytest.raises(
        NodeError, match=r"^n: take \(handler of 'word'\) failed: ValueError: below 0$"
    ) as caught:
        drive.consume("/p/word", Word(n=-1))
    assert caught.value.node == "n"
    assert isinstance(caught.value.__cause__, ValueError)
    assert drive.node.state.log == ["word -1 of x", "error below 0", "deactivate"]
    assert drive.sent("/n/out", Word) == [Word(n=0)]
    assert drive.executor.lifecycle is Lifecycle.FINALIZED
    assert drive.executor.next_due_ns() is None
    drive.executor.run_timers()
    drive.executor.transition(Transition.SHUTDOWN)
    assert drive.node.state.log[-1] == "deactivate"


def raises(error: BaseException) -> Any:
    def method(*_: Any) -> None:
        raise error

    return method


@pytest.mark.parametrize(
    ("failure", "text"),
    [(GraphError("first"), "failed: first$"), (SystemExit(3), "method .* failed: SystemExit: 3")],
)
def test_a_node_that_fails_reaches_its_safe_state_even_if_a_hook_raises(
    failure: BaseException, text: str
) -> None:
    word, safe = Sub(Word), list[str]()
    hooks = {"on_error": raises(RuntimeError("second")), "on_deactivate": lambda _: safe.append("safe")}
    doomed = type("Doomed", (Node,), {"word": word, "take": on(word)(raises(failure)), **hooks})
    drive = Drive(doomed, **WIRED)
    with pytest.raises(NodeError, match=text):
        drive.consume("/p/word", Word(n=1))
    assert safe == ["safe"]


@pytest.mark.parametrize("hook", ["on_configure", "on_activate", "on_deactivate", "on_shutdown"])
def test_a_hook_that_raises_is_named(hook: str) -> None:
    broken = type("Broken", (Node,), {hook: raises(OSError("no device"))})
    executor = Executor(broken, NodeSpec(name="n", run="m:N"), SimClock(), print)

    def live() -> None:
        for transition in (Transition.CONFIGURE, Transition.ACTIVATE, Transition.SHUTDOWN):
            executor.transition(transition)

    with pytest.raises(NodeError, match=f"n: {hook} failed: OSError: no device"):
        live()
    assert executor.lifecycle is Lifecycle.FINALIZED


class Server(Node):
    state: LogState
    total = Srv(Word, Other)

    @serve(total)
    def answer(self, request: Word) -> Other:
        self.state.log.append(str(request.n))
        return Other(n=2 * request.n) if request.n else None  # type: ignore[return-value]


def test_two_clients_of_a_service_each_get_their_own_replies_and_a_wrong_one_fails_by_name() -> None:
    drive = Drive(Server, requests={"total": ["/a/ask", "/b/ask"]})
    drive.consume("/a/ask", Word(n=1), 1)
    drive.consume("/b/ask", Word(n=2), 1)
    drive.consume("/a/ask", Word(n=3), 2)
    assert drive.sent("/n/total/a/ask", Other) == [Other(n=2), Other(n=6)]
    assert drive.sent("/n/total/b/ask", Other) == [Other(n=4)]
    assert drive.node.state.log == ["1", "2", "3"]
    words = r"answer \(handler of 'total'\) failed: .* carries Other, not NoneType"
    with pytest.raises(NodeError, match=words):
        drive.consume("/a/ask", Word(n=0), 3)


def test_a_call_returns_at_once_and_its_reply_arrives_later() -> None:
    asker = Drive(Everything, inputs={"ask": "/s/total", "word": "/p/word"})
    asker.node.ask.call(Word(n=4))
    assert asker.sent("/n/ask", Word) == [Word(n=4)]
    assert asker.node.state.log == []
    asker.consume("/s/total/n/ask", Other(n=8))
    assert asker.node.state.log == ["learnt 8"]
    assert list(asker.executor.ends.accounts) == ["/p/word", "/s/total/n/ask"]


def test_one_topic_can_feed_two_inputs() -> None:
    class Twice(Node):
        state: LogState
        one = Sub(Word)
        two = Sub(Word)

        @on(two)
        def take_two(self, word: Word) -> None:
            self.state.log.append("two")

        @on(one)
        def take_one(self, word: Word) -> None:
            self.state.log.append("one")

    drive = Drive(Twice, inputs={"one": "/p/word", "two": "/p/word"})
    drive.consume("/p/word", Word(n=1))
    assert drive.node.state.log == ["one", "two"]


def test_what_a_port_is_not_for_is_refused_by_name() -> None:
    unwired = Drive(Everything)
    unwired.consume("/p/word", Word(n=1))
    assert (unwired.executor.ends.accounts, unwired.executor.events.rejected_count) == ({}, 1)
    with pytest.raises(TypeError, match="/n/out carries Word, not Other"):
        unwired.node.out.publish(Other(n=1))
    context: Any = object()
    for name in ("out", "second", "bell", "ask"):
        with pytest.raises(AttributeError, match=f"{name} works only while an executor runs the node"):
            getattr(Everything(context), name)


class SquareState(State):
    table: Float64Array = np.zeros((2, 2))


def test_a_state_that_cannot_be_written_down_fails_the_node_by_name() -> None:
    def spoil(node: Any) -> None:
        node.state.log = [object()]

    bad = type("Bad", (Node,), {"__annotations__": {"state": LogState}, "on_configure": spoil})
    with pytest.raises(NodeError, match="n: its state cannot be written down"):
        Drive(bad)
    square = type("Square", (Node,), {"__annotations__": {"state": SquareState}})
    with pytest.raises(GraphError, match=r"n: SquareState cannot be handed over: an array of shape \(2, 2\)"):
        Drive(square)


def test_randomness_is_a_function_of_seed_and_name() -> None:
    def draws(**spec: Any) -> list[float]:
        executor = Executor(Everything, NodeSpec(run="m:N", **spec), SimClock(), print)
        return list(executor.rng.random(3))

    assert draws(name="a", seed=1) == draws(name="a", seed=1)
    different = [draws(name="a", seed=1), draws(name="a", seed=2), draws(name="b", seed=1)]
    assert len(np.unique(different)) == 9


def test_a_node_says_when_its_work_is_done() -> None:
    drive = Drive(type("Done", (Node,), {"on_activate": lambda node: node.finish(np.int64(3))}))
    assert drive.executor.exit_code == 3
    assert type(drive.executor.exit_code) is int


class ArrayState(State):
    buffer: Float64Array = np.zeros(2)


def test_two_nodes_of_a_class_do_not_share_a_default_array() -> None:
    buffering = type("Buffering", (Node,), {"__annotations__": {"state": ArrayState}})
    Drive(buffering).node.state.buffer[0] += 4.0
    assert Drive(buffering).node.state.buffer.tolist() == [0.0, 0.0]
