"""What methods cost and how wrong they are here and now: a function per task measures it.

A package that declares methods may say how they are measured: an entry point of the group :data:`GROUP`,
named as the task, whose value is ``module:function``. The function is called with the scene and yields each
way as soon as it is measured, the cheap ones first, so that the caller may stop at any time.
"""

import itertools
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from palp_core.errors import MethodError, PalpError
from palp_core.foreign import catch_foreign
from palp_core.methods.register import names

GROUP = "palp.measures"
"""Entry points by task: the functions that measure its methods."""

REFERENCE = "the reference"
"""Condition of what the others were held against, whose own error is 0 by definition."""


@dataclass(frozen=True)
class Measured:
    """A method at a setting, measured.

    Attributes:
        task: Its task.
        method: Its name in the register.
        setting: Its resolution or parameters, in words; empty where there is nothing to set.
        cost_s: Seconds of one core for one use, as the task counts them.
        error: Error of ``output`` against what ``against`` names; NaN where it gave no answer.
        output: What the error is of.
        against: What it was held against, in words.
        usual: Whether this is the setting that is taken when the method is.
        condition: Under which the method was measured where it is not the scene itself, as in ``ring 0 mm``.
        fails: Why it is not to be trusted there, in words; empty where it is.
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
    return sorted({point.name for point in entry_points(group=GROUP)})


def measure_of(task: str) -> list[Measure]:
    """Return the functions that measure a task's methods; one that cannot be loaded leaves the others theirs.

    Raises:
        MethodError: There is none, or none can be loaded.
    """
    tried = _tried(task)
    found = [one for one in tried if not isinstance(one, MethodError)]
    if not found:
        raise next(
            (one for one in tried if isinstance(one, MethodError)),
            MethodError(
                f"nothing measures the methods of task '{task}'; measured are {', '.join(measured_tasks())}"
            ),
        )
    return found


def _tried(task: str) -> list[Measure | MethodError]:
    return [_loaded(point) for point in entry_points(group=GROUP) if point.name == task]


def _loaded(point: EntryPoint) -> Measure | MethodError:
    try:
        measure: Measure = point.load()
    except Exception as error:  # noqa: BLE001 -- whatever a package raises as it is imported
        of = f" of package '{point.dist.name}'" if point.dist else ""
        kind = "" if isinstance(error, PalpError) else f"{type(error).__name__}: "
        return MethodError(
            f"what measures task '{point.name}', {point.value}{of}, cannot be loaded: {kind}{error}"
        )
    return measure


class Survey:
    """The points of tasks, measured in turns.

    Args:
        names: Of the tasks.
        scene: What each measure is called with.

    Raises:
        MethodError: No measure of a task can be loaded.
    """

    def __init__(self, names: Sequence[str], scene: object) -> None:
        self.failed = False
        """Whether a measure failed, or cannot be loaded."""
        self.missing: list[str] = []
        """What was not measured and why, in words."""
        self._found: dict[tuple[str, ...], Measured] = {}
        self._running: dict[str, Iterator[Measured]] = {}
        for name in names:
            measures = measure_of(name)
            self._running[name] = itertools.chain.from_iterable(one(scene) for one in measures)
            self.missing += [str(one) for one in _tried(name) if isinstance(one, MethodError)]
        self.failed = bool(self.missing)

    @property
    def points(self) -> list[Measured]:
        """What was measured; of the same method at the same setting, the last."""
        return list(self._found.values())

    def measure(self, budget_s: float) -> None:
        """Take a point of each task by turns, until all is measured or the time is up."""
        end_ns = time.monotonic_ns() + round(1e9 * budget_s)
        while self._running and time.monotonic_ns() < end_ns:
            name = next(iter(self._running))
            points = self._running.pop(name)
            try:
                with catch_foreign("its measure", MethodError):
                    one = next(points, None)
                if one is not None:
                    self._add(name, one)
                    self._running[name] = points  # at the end of the turn
            except PalpError as error:
                self.failed = True
                self.missing.append(f"{name}: {error}")
        self.missing += [f"{name}: time was up" for name in self._running]

    def _add(self, name: str, one: Measured) -> None:
        if one.task != name or one.method not in names(name):
            raise MethodError(
                f"it measured '{one.method}' of task '{one.task}', which is not in the register"
            )
        if not 0.0 < one.cost_s < math.inf:
            raise MethodError(f"it gave '{one.method}' a cost of {one.cost_s:g} s")
        # a reference takes the place of what was held against another
        condition = "" if one.condition == REFERENCE else one.condition
        self._found[name, one.method, one.setting, one.output, condition] = one


def cpu_s(
    action: Callable[[], object],
    *,
    least_s: float = 0.02,
    rounds: int = 3,
    long_s: float = 0.3,
    clock: Callable[[], int] = time.thread_time_ns,
) -> float:
    """Return the CPU time of one call of an action, in s: the least of some rounds of enough calls.

    Args:
        action: What is timed; called once before the rounds, and again if that has loaded modules.
        least_s: CPU time of a round.
        rounds: How many.
        long_s: A call that takes longer is the only one, and it is what is returned.
        clock: CPU time in ns; :func:`time.process_time_ns` where other threads work for the action.
    """
    first_s, before, loaded = 0.0, -1, len(sys.modules)
    while loaded != before:  # to load modules takes longer than many a call, and only once
        begun_ns, before = clock(), loaded
        action()
        first_s, loaded = (clock() - begun_ns) / 1e9, len(sys.modules)
    if first_s > long_s:
        return first_s
    count, best_s = 1, float("inf")
    done = 0
    while done < rounds:
        begun_ns = clock()
        for _ in range(count):
            action()
        taken_s = (clock() - begun_ns) / 1e9
        if taken_s < least_s and count < 1 << 20:
            count = max(2 * count, round(count * least_s / max(taken_s, 1e-6)))
            continue
        best_s, done = min(best_s, taken_s / count), done + 1
    return best_s
