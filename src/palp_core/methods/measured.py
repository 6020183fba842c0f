"""What methods cost and how wrong they are here and now: a function per task measures it.

A task names it as :attr:`.Task.measure`. It is called with the scene and yields each way as soon as it is
measured, the cheap ones first, so that the caller may stop at any time.
"""

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from statistics import median
from typing import Any

from palp_core.errors import MethodError, PalpError
from palp_core.foreign import catch_foreign
from palp_core.methods import register

UNIT_S = 0.0067
"""CPU time of :func:`slowness`'s work on the machine where the declared costs were measured."""

REFERENCE = "the reference"
"""Condition of what the others were held against, whose own error is 0 by definition."""


@dataclass(frozen=True)
class Measured:
    """A method at a setting, measured.

    Attributes:
        task: Its task.
        method: Its name in the register.
        setting: Its resolution or parameters; empty where there is nothing to set.
        cost_s: Seconds of one core for one use.
        error: Error of ``output`` against what ``against`` names; NaN where it gave no answer.
        output: As in ``peak``.
        against: The reference.
        usual: This is the setting that a run takes.
        condition: As in ``ring 0 mm``; empty where it is the scene itself.
        fails: Why it is not valid there; empty where it is.
    """

    task: str
    method: str
    setting: str
    cost_s: float
    error: float
    output: str
    against: str
    usual: bool = True
    condition: str = ""
    fails: str = ""


Measure = Callable[[Any], Iterator[Measured]]
"""Takes a :class:`palp_core.palpation.mechanics.scene.scene.Scene`; gives what it measures, cheap first."""


def measured_tasks() -> list[str]:
    """Return the tasks that can be measured, by name."""
    return [one.name for one in register.tasks() if one.measure]


def measure_of(task: str) -> Measure:
    """Return the function that measures a task's methods."""
    place = register.task(task).measure
    if not place:
        known = ", ".join(measured_tasks())
        raise MethodError(f"nothing measures the methods of task '{task}'; measured are {known}")
    measure: Measure = register.load(place, f"what measures task '{task}'")
    return measure


class Survey:
    """The points of tasks, measured in turns; ``missing`` says what was not measured and why."""

    def __init__(self, tasks: Sequence[str], scene: object) -> None:
        self.missing: list[str] = []
        self.failed = False
        self._found: dict[tuple[str, ...], Measured] = {}
        self._running = {task: measure_of(task)(scene) for task in tasks}

    @property
    def points(self) -> list[Measured]:
        return list(self._found.values())

    def measure(self, budget_s: float) -> None:
        """Take a point of each task by turns, until all is measured or the time is up."""
        end_ns = time.monotonic_ns() + round(1e9 * budget_s)
        while self._running and time.monotonic_ns() < end_ns:
            task = next(iter(self._running))
            points = self._running.pop(task)
            try:
                with catch_foreign("its measure", MethodError):
                    point = next(points, None)
                if point is not None:
                    self._add(task, point)
                    self._running[task] = points  # at the end of the turn
            except PalpError as error:
                self.failed = True
                self.missing.append(f"{task}: {error}")
        self.missing += [f"{task}: time was up" for task in self._running]

    def _add(self, task: str, point: Measured) -> None:
        if point.task != task or point.method not in register.names(task):
            raise MethodError(
                f"it measured '{point.method}' of task '{point.task}', which is not in the register"
            )
        if not 0.0 < point.cost_s < math.inf:
            raise MethodError(f"it gave '{point.method}' a cost of {point.cost_s:g} s")
        # a reference takes the place of what was held against another
        condition = "" if point.condition == REFERENCE else point.condition
        self._found[task, point.method, point.setting, point.output, condition] = point


def cpu_s(
    action: Callable[[], object],
    *,
    least_s: float = 0.02,
    rounds: int = 3,
    long_s: float = 0.3,
    clock: Callable[[], int] = time.thread_time_ns,
) -> float:
    """Return the CPU time of one call of an action, in s: the least of some rounds of ``least_s`` each.

    A call that takes longer than ``long_s`` is the only one. ``clock`` is :func:`time.process_time_ns` where
    other threads work for the action.
    """
    first_s, before, loaded = 0.0, -1, len(sys.modules)
    while loaded != before:  # to load modules takes longer than many a call, and only once
        before = loaded
        first_s, loaded = _timed_s(action, 1, clock), len(sys.modules)
    if first_s > long_s:
        return first_s
    count, times = 1, list[float]()
    while len(times) < rounds:
        taken_s = _timed_s(action, count, clock)
        if taken_s < least_s and count < 1 << 20:
            count = max(2 * count, round(count * least_s / max(taken_s, 1e-6)))
        else:
            times.append(taken_s / count)
    return min(times)


def _timed_s(action: Callable[[], object], count: int, clock: Callable[[], int]) -> float:
    begun_ns = clock()
    for _ in range(count):
        action()
    return (clock() - begun_ns) / 1e9


@cache
def slowness() -> float:
    """Return the CPU time of fixed work, half interpreter and half arrays, over :data:`UNIT_S`."""
    import numpy as np

    values = np.linspace(0.0, 1.0, 20_000)

    def work() -> None:
        nonlocal values
        total = 0
        for i in range(100_000):
            total += i & 7
        for _ in range(20):
            values = np.sort(np.sin(values) + 1e-3)

    return median(_timed_s(work, 1, time.thread_time_ns) for _ in range(5)) / UNIT_S
