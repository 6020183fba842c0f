"""A node goes on from where a successor of another class had come, and keeps what only it has."""

from typing import Self

from palp_core.graph.clock import SimClock
from palp_core.graph.messages.message import Message
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.node import Node, Params, State
from palp_core.graph.node.ports import Alarm, Pub, Sub, Timer, on
from palp_core.graph.node.spec import NodeSpec


class Number(Message):
    n: int


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
    number = Sub(Number)
    out = Pub(Number)
    other = Pub(Number)
    timer = Timer("rate_hz", running=False)
    alarm = Alarm()

    def on_activate(self) -> None:
        self.timer.start()
        self.alarm.set(8_000_000_000)
        self.other.publish(Number(n=1))

    @on(number)
    def take(self, number: Number) -> None:
        self.state.total += number.n

    @on(timer)
    def tick(self) -> None: ...

    @on(alarm)
    def ring(self) -> None: ...


class Thin(Node):
    state: Total
    number = Sub(Number)
    out = Pub(Number)

    @on(number)
    def take(self, number: Number) -> None:
        self.state.total += 10 * number.n
        self.out.publish(number)


def test_what_only_the_old_class_has_is_as_it_was() -> None:
    clock, frames = SimClock(), list[bytes]()
    spec = NodeSpec(name="relay", run="m:C", inputs={"number": "/source/out"})
    old, new = (Executor(cls, spec, clock, frames.append) for cls in (Full, Thin))
    for executor in (old, new):
        executor.transition(Transition.CONFIGURE)
    old.transition(Transition.ACTIVATE)
    before = old.ends.write_down()
    old.pause()
    new.take_over(old.hand_over())
    new.node.take(Number(n=3))  # type: ignore[attr-defined]
    old.take_back(new.full_snapshot(), list(new.ends.timed))
    after = old.ends.write_down()
    assert old.node.state == Total(total=30)
    assert after["alarms"] == before["alarms"] == {"alarm": 8_000_000_000}
    assert after["timers"] == before["timers"]
    assert after["published"]["/relay/other"] == before["published"]["/relay/other"] == 1
    assert after["published"]["/relay/out"] == before["published"]["/relay/out"] + 1
    assert old.is_active
    assert not old.paused
