"""Timers tick on the grid round(k 1e9 / rate), for ever; alarms ring once."""

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.graph.node.timers import AlarmEnd, TimerEnd

MS = 1_000_000


class Owner:
    """The time and the parameters of a node with a timer or an alarm."""

    def __init__(self, rate_hz: float, now_ns: int = 0) -> None:
        self.set_rate(rate_hz)
        self.now = now_ns
        self.context: Any = self

    def now_ns(self) -> int:
        return self.now

    def set_rate(self, rate_hz: float) -> None:
        self.node = SimpleNamespace(params=SimpleNamespace(rate_hz=rate_hz))

    def timer(self, *, running: bool = True) -> TimerEnd:
        return TimerEnd("tick", self.context, "rate_hz", running=running, handler=lambda _: None)

    def alarm(self) -> AlarmEnd:
        return AlarmEnd("alarm", "alarm", self.context)


@pytest.mark.parametrize(
    "rate_hz", [3.0, *(pytest.param(hz, marks=pytest.mark.nightly) for hz in (1500.0, 0.7))]
)
def test_a_million_ticks_at_an_awkward_rate_do_not_drift(rate_hz: float) -> None:
    timer = Owner(rate_hz).timer()
    timer.activate(0)
    exact_period_ns = Fraction(10**9) / Fraction(rate_hz)
    for k in range(1, 1_000_001):
        due_ns = timer.due_ns
        assert timer.tick() == k
        if k % 997 == 0 or k > 999_900:
            assert due_ns is not None
            assert abs(due_ns - k * exact_period_ns) <= 1


@given(st.floats(1e-3, 1e6), st.integers(0, 10**14))
def test_a_started_timer_is_due_at_the_first_grid_instant_after_now(rate_hz: float, now_ns: int) -> None:
    timer = Owner(rate_hz).timer()
    timer.activate(now_ns)
    due_ns = timer.due_ns
    assert due_ns is not None
    assert due_ns > now_ns
    assert due_ns == round(timer.k * 1e9 / rate_hz)
    assert round((timer.k - 1) * 1e9 / rate_hz) <= now_ns


ACTIVATE = ("activate", 0)


@pytest.mark.parametrize(
    ("running", "rate_hz", "deeds", "due_ms"),
    [
        pytest.param(False, 10.0, [ACTIVATE], None, id="one that is not running waits"),
        pytest.param(False, 10.0, [ACTIVATE, ("start", 250)], 300, id="for its start"),
        pytest.param(True, 10.0, [ACTIVATE, ("start", 500)], 100, id="a start changes nothing if it ticks"),
        pytest.param(True, 10.0, [ACTIVATE, ("stop", 0)], None, id="a stopped timer"),
        pytest.param(True, 10.0, [ACTIVATE, ("stop", 0), ("start", 1234)], 1300, id="keeps its grid"),
        pytest.param(True, 4.0, [ACTIVATE, ("retime", 30)], 250, id="a changed rate has another grid"),
        pytest.param(False, 4.0, [ACTIVATE, ("retime", 0)], None, id="a stopped timer stays stopped"),
        pytest.param(True, 10.0, [("resume", (7, 700), 650)], 700, id="a successor continues the ticks"),
        pytest.param(True, 10.0, [("resume", (7, 700), 650), ("tick", 700)], 800, id="and goes on"),
        pytest.param(True, 10.0, [("resume", (7, None), 650)], None, id="or stays stopped"),
        pytest.param(True, 100.0, [("resume", (101, 10_100), 10_000)], 10_010, id="one at a higher rate"),
        pytest.param(True, 0.5, [("resume", (101, 10_100), 10_000)], 12_000, id="and one at a lower"),
        pytest.param(True, 10.0, [("resume", None, 250)], 300, id="one that the predecessor had not begins"),
        pytest.param(False, 10.0, [("resume", None, 250)], None, id="if it is running"),
    ],
)
def test_a_timer_is_due_when_it_was_told_to_be(
    running: bool, rate_hz: float, deeds: list[tuple[Any, ...]], due_ms: int | None
) -> None:
    owner = Owner(10.0 if ("retime" in str(deeds)) else rate_hz)
    timer = owner.timer(running=running)
    for name, *given_ms in deeds:
        owner.now = given_ms[-1] * MS
        if name == "retime":
            owner.set_rate(rate_hz)
        if name == "resume":
            saved = given_ms[0] and (given_ms[0][0], given_ms[0][1] and given_ms[0][1] * MS)
            timer.resume(saved, owner.now)
        else:
            getattr(timer, name)(*([owner.now] if name in ("activate", "retime") else []))
    assert timer.due_ns == (None if due_ms is None else due_ms * MS)


def test_an_alarm_rings_once_and_the_last_setting_counts() -> None:
    alarm = Owner(1.0, now_ns=6).alarm()
    alarm.set(3)
    assert alarm.due_ns == 6  # at once
    alarm.set(9)
    assert alarm.due_ns == 9
    assert alarm.tick() == 0
    for clear in (alarm.clear, lambda: alarm.activate(0)):
        alarm.set(9)
        clear()
        assert alarm.due_ns is None
    with pytest.raises(TypeError, match="integer"):
        alarm.set(0.5e9)  # type: ignore[arg-type]
