"""Timers tick on the grid round(k 1e9 / rate), for ever; alarms ring once."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.node.timers import AlarmEnd, TimerEnd


class Owner:
    """The time and the parameters of a node with a timer or an alarm."""

    def __init__(self, rate_hz: float) -> None:
        self.set_rate(rate_hz)
        self.now = 0
        self.context: Any = self

    def now_ns(self) -> int:
        return self.now

    def set_rate(self, rate_hz: float) -> None:
        self.node = SimpleNamespace(params=SimpleNamespace(rate_hz=rate_hz))

    def timer(self, *, running: bool = True) -> TimerEnd:
        return TimerEnd("tick", self.context, "rate_hz", running=running, handler=lambda _: None)

    def alarm(self) -> AlarmEnd:
        return AlarmEnd("alarm", "alarm", self.context)


@pytest.mark.parametrize("rate_hz", [3.0, 1500.0, 0.7])
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


def test_3_hz_meets_every_whole_second() -> None:
    timer = Owner(3.0).timer()
    timer.activate(0)
    due = []
    for _ in range(6):
        due.append(timer.due_ns)
        timer.tick()
    assert due == [333333333, 666666667, 10**9, 1333333333, 1666666667, 2 * 10**9]


@settings(deadline=None, max_examples=200)
@given(st.floats(1e-3, 1e6), st.integers(0, 10**14))
def test_a_started_timer_is_due_at_the_first_grid_instant_after_now(rate_hz: float, now_ns: int) -> None:
    timer = Owner(rate_hz).timer()
    timer.activate(now_ns)
    due_ns = timer.due_ns
    assert due_ns is not None
    assert due_ns > now_ns
    assert due_ns == round(timer.k * 1e9 / rate_hz)
    assert round((timer.k - 1) * 1e9 / rate_hz) <= now_ns


def test_a_timer_that_is_not_declared_running_waits_for_its_start() -> None:
    owner = Owner(10.0)
    timer = owner.timer(running=False)
    timer.activate(0)
    assert timer.due_ns is None
    owner.now = 250_000_000
    timer.start()
    assert timer.due_ns == 300_000_000


def test_starting_a_timer_that_ticks_changes_nothing() -> None:
    owner = Owner(10.0)
    timer = owner.timer()
    timer.activate(0)
    owner.now = 500_000_000
    timer.start()
    assert timer.due_ns == 100_000_000


def test_a_stopped_timer_restarts_on_the_same_grid() -> None:
    owner = Owner(10.0)
    timer = owner.timer()
    timer.activate(0)
    timer.stop()
    assert timer.due_ns is None
    owner.now = 1_234_000_000
    timer.start()
    assert timer.k == 13
    assert timer.due_ns == 1_300_000_000


def test_a_changed_rate_moves_to_the_new_grid() -> None:
    owner = Owner(10.0)
    timer = owner.timer()
    timer.activate(0)
    owner.set_rate(4.0)
    timer.retime(30_000_000)
    assert (timer.k, timer.due_ns) == (1, 250_000_000)


def test_a_stopped_timer_stays_stopped_when_its_rate_changes() -> None:
    owner = Owner(10.0)
    timer = owner.timer(running=False)
    timer.activate(0)
    owner.set_rate(4.0)
    timer.retime(0)
    assert timer.due_ns is None


def test_a_successor_with_the_same_rate_continues_the_ticks() -> None:
    timer = Owner(10.0).timer()
    timer.resume((7, 700_000_000), 650_000_000)
    assert (timer.k, timer.due_ns) == (7, 700_000_000)
    timer.tick()
    assert timer.due_ns == 800_000_000
    timer.resume((7, None), 650_000_000)
    assert timer.due_ns is None


def test_a_successor_with_another_rate_neither_catches_up_nor_waits_for_the_old_grid() -> None:
    for rate_hz, due_ns in ((100.0, 1_000_010_000_000), (0.5, 1_002_000_000_000)):
        timer = Owner(rate_hz).timer()
        timer.resume((10_001, 1_000_100_000_000), 1_000_000_000_000)
        assert timer.due_ns == due_ns


def test_a_timer_that_the_predecessor_did_not_have_begins() -> None:
    running, waiting = Owner(10.0).timer(), Owner(10.0).timer(running=False)
    running.resume(None, 250_000_000)
    waiting.resume(None, 250_000_000)
    assert [running.due_ns, waiting.due_ns] == [300_000_000, None]


def test_an_alarm_in_the_past_rings_now() -> None:
    owner = Owner(1.0)
    owner.now = 1000
    alarm = owner.alarm()
    alarm.set(3)
    assert alarm.due_ns == 1000


def test_an_alarm_rings_once_and_the_last_setting_counts() -> None:
    alarm = Owner(1.0).alarm()
    alarm.set(5)
    alarm.set(9)
    assert alarm.due_ns == 9
    assert alarm.tick() == 0
    assert alarm.due_ns is None
    alarm.set(5)
    alarm.clear()
    assert alarm.due_ns is None
    alarm.set(5)
    alarm.activate(0)
    assert alarm.due_ns is None


def test_an_alarm_refuses_a_time_that_is_not_whole_nanoseconds() -> None:
    with pytest.raises(TypeError, match="integer"):
        Owner(1.0).alarm().set(0.5e9)  # type: ignore[arg-type]
