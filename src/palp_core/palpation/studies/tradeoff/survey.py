"""Every method of every task measured in a scene, for as long as there is time: all tasks in turns.

First each task's first point, of those the cheapest first; then always the task that has taken least.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from palp_core.counted import counted
from palp_core.errors import MethodError, PalpError
from palp_core.graph.clock import monotonic_ns
from palp_core.methods.measured import REFERENCE, Measured, first_s, measure_of
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.session.method_choices import TaskChoice
from palp_core.palpation.studies.contact.case import FailureCase
from palp_core.palpation.studies.contact.cases_other import contact_cases

_DRAWING_S = 0.5  # that a task's chart and table take of the budget; no more than a quarter of it in all
_LONGEST_S = 1e9  # an alarm knows no more than its clock
_AGAIN_S = 2.0  # an alarm that came where exceptions are swallowed comes again


class _TimeIsUp(BaseException):
    """No error, and nothing that a measure may take for one."""


@dataclass
class TaskSurvey:
    """What is known of a task.

    Attributes:
        choice: The task, and what the register offers the scene.
        points: What was measured; of the same method at the same setting, the last.
        cases: Where a method fails, over a parameter of its own.
        took_s: Seconds that it took.
        missing: Why it is not complete, in words; empty if it is.
        broken: Whether a measure of it failed.
    """

    choice: TaskChoice
    points: list[Measured] = field(default_factory=list)
    cases: list[FailureCase] = field(default_factory=list)
    took_s: float = 0.0
    missing: str = ""
    broken: bool = False

    def add(self, found: Measured | FailureCase) -> None:
        """Add what was found; a point replaces what was measured of the same method at the same setting.

        Raises:
            MethodError: It is of another task, of no method of this one, or has no cost.
        """
        if isinstance(found, FailureCase):
            self.cases.append(found)
            return
        self._check(found)
        key = _key(found)
        self.points = [one for one in self.points if _key(one) != key] + [found]

    def _check(self, found: Measured) -> None:
        name = self.choice.task.name
        if found.task != name:
            raise MethodError(f"it measured '{found.method}' of task '{found.task}'")
        if found.method not in {one.name for one in self.choice.candidates}:
            raise MethodError(f"it measured '{found.method}', of which task '{name}' has no method")
        if not 0.0 < found.cost_s < math.inf:
            raise MethodError(f"it gave '{found.method}' a cost of {found.cost_s:g} s")


def _key(one: Measured) -> tuple[str, str, str, str]:
    """Return what is measured once; a reference may take the place of what was held against another."""
    return one.method, one.setting, one.output, "" if one.condition == REFERENCE else one.condition


@dataclass
class Survey:
    """What was measured in a scene.

    Attributes:
        scene: The scene.
        budget_s: Seconds there were; None: as many as it takes.
        tasks: By task.
        took_s: Seconds that it took.
        ended: ``complete``, ``budget`` or ``interrupted``.
    """

    scene: Scene
    budget_s: float | None
    tasks: list[TaskSurvey]
    took_s: float = 0.0
    ended: str = "complete"

    @property
    def left_out(self) -> str:
        """What is missing and why, in words; empty if nothing is."""
        return "; ".join(f"{one.choice.task.name}: {one.missing}" for one in self.tasks if one.missing)

    @property
    def broken(self) -> bool:
        """Whether a measure failed."""
        return any(one.broken for one in self.tasks)


def take(
    scene: Scene,
    choices: Sequence[TaskChoice],
    *,
    budget_s: float | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Survey:
    """Measure the tasks in turns, as the module says, until all is done, time is up, or Ctrl-C.

    Runs in the main thread, whose alarm it sets.

    Args:
        scene: What is swept.
        choices: The tasks.
        budget_s: Seconds that it may take, with those that drawing will take.
        tell: Told what is being measured.
    """
    tasks = [TaskSurvey(one) for one in choices]
    survey = Survey(scene, budget_s, tasks)
    running = {number: _all_of(one, scene) for number, one in enumerate(tasks)}
    first = [_first_s(one) for one in tasks]

    def turn(number: int) -> tuple[bool, float]:
        one = tasks[number]
        return (True, one.took_s) if one.took_s else (False, first[number])

    begun_ns = monotonic_ns()
    try:
        with _alarm(_measuring_s(budget_s, len(tasks))):
            while running:
                number = min(running, key=turn)
                tell(_progress(tasks, running, number, (monotonic_ns() - begun_ns) / 1e9, budget_s))
                if not _step(tasks[number], running[number]):
                    del running[number]
    except (_TimeIsUp, KeyboardInterrupt) as end:
        survey.ended = "budget" if isinstance(end, _TimeIsUp) else "interrupted"
    survey.took_s = (monotonic_ns() - begun_ns) / 1e9
    for number in running:
        tasks[number].missing = "not measured to its end" if tasks[number].points else "nothing measured"
    return survey


def _measuring_s(budget_s: float | None, count: int) -> float | None:
    return None if budget_s is None else budget_s - min(_DRAWING_S * count, budget_s / 4.0)


def _first_s(one: TaskSurvey) -> float:
    """Return the seconds until the first point of a task; 0 for one that will say why it has none."""
    try:
        return first_s(measure_of(one.choice.task.name)[0])
    except MethodError:
        return 0.0


def _all_of(one: TaskSurvey, scene: Scene) -> Iterator[Measured | FailureCase]:
    for measure in measure_of(one.choice.task.name):
        yield from measure(scene)
    if one.choice.task.name == "contact":
        yield from contact_cases(quick=True)


def _step(one: TaskSurvey, found: Iterator[Measured | FailureCase]) -> bool:
    """Take the next point of a task; tell whether there may be more."""
    begun_ns = monotonic_ns()
    try:
        one.add(next(found))
    except StopIteration:
        return False
    except MethodError as error:
        one.missing, one.broken = f"its measure failed: {error}", True
        return False
    except PalpError as error:
        one.missing = str(error)
        return False
    except (Exception, SystemExit) as error:  # noqa: BLE001 -- a lab's own measure that fails leaves the others theirs
        one.missing, one.broken = f"its measure failed: {type(error).__name__}: {error}", True
        return False
    finally:
        one.took_s += (monotonic_ns() - begun_ns) / 1e9
    return True


def _progress(
    tasks: Sequence[TaskSurvey],
    left: Mapping[int, object],
    number: int,
    spent_s: float,
    budget_s: float | None,
) -> str:
    count = sum(len(one.points) for one in tasks)
    of = f" of {budget_s:g}" if budget_s is not None else ""
    name = tasks[number].choice.task.name
    done = len(tasks) - len(left)
    return f"{name}: {counted(count, 'point')} so far, {done} of {len(tasks)} tasks done, {spent_s:.0f}{of} s"


@contextmanager
def _alarm(budget_s: float | None) -> Iterator[None]:
    """Raise :class:`_TimeIsUp` when the time is up, in the midst of whatever is being measured."""
    if budget_s is None:
        yield
        return

    def ring(_number: int, _frame: FrameType | None) -> None:
        raise _TimeIsUp

    others = signal.signal(signal.SIGALRM, ring)
    left = signal.setitimer(signal.ITIMER_REAL, min(budget_s, _LONGEST_S), _AGAIN_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, others)
        signal.setitimer(signal.ITIMER_REAL, *left)
