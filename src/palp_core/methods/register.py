"""What there is to choose from: tasks, and the methods declared for each."""

import importlib
import inspect
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from palp_core.errors import MethodError, PalpError
from palp_core.methods.quantities import require_declared

T = TypeVar("T")
Range = tuple[float, float]
Quantities = Mapping[str, float | tuple[float, ...]]
"""Quantities of a scene by name, SI; one value, or several that all occur."""

GROUP = "palp.methods"
"""Entry points by task: the modules that declare its methods, imported when a task is first used."""

# A parameter's `auto` leaves it to the register, and a colon parts a name from its module.
_NAME = re.compile(r"(?!auto$)\w[\w.-]*")
_PALP = "palp_core."
_ROLE = re.compile(r":\w+:`[.~]*([^`]*)`|``")  # of a docstring's words, not for people


@dataclass(frozen=True)
class Task:
    """Something that can be done in several ways.

    Attributes:
        name: As in ``contact``.
        question: What its methods answer, in words.
        per: What the cost of a method is for, as in ``a sweep of 4000 samples``.
        output: What must be right unless the scene says otherwise.
        tolerance: How right; as the bounds of its methods count.
    """

    name: str
    question: str
    per: str
    output: str
    tolerance: float


@dataclass(frozen=True)
class Bound:
    """A stated error of one output, and the scenes in which it holds.

    Attributes:
        output: What the bound is about, as in ``peak`` or ``contrast``.
        error: Largest error; relative, dimensionless, unless the task's output says otherwise.
        within: Inclusive range per declared quantity; one that the scene does not have is not checked.

    Raises:
        MethodError: The error is negative, infinite or NaN, or a range has no inside.
    """

    output: str
    error: float
    within: Mapping[str, Range] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0.0 <= self.error < math.inf:
            raise MethodError(
                f"a bound on '{self.output}' of {self.error:g} is none; give the largest error seen"
            )
        _check_ranges(self.within, f"a bound on '{self.output}'")

    def holds(self, scene: Quantities) -> bool:
        return not _strays(self.within, scene)


@dataclass(frozen=True, kw_only=True)
class Method:
    """One method: what it does, what it costs, how wrong it is, and where it fails.

    As a decorator, :data:`method`, it declares a function or class.

    Attributes:
        task: What it is exchangeable for, as in ``contact``, ``denoise``, ``stop``.
        name: Its name within the task.
        cost_s: Seconds of one core for one use, on the machine whose unit is
            :data:`palp_core.methods.measured.UNIT_S`; orders the choice.
        evidence: Where the stated errors were established.
        bounds: Stated errors, each with the scenes in which it holds.
        valid: Range per scene quantity outside which the method must not be used at all.
        fails: What happens beyond that range.
        survivor: Name of the method of the same task to use there.
        reference: Why it is declared though it is never chosen, as for a method kept to show where it fails.
        target: The function or class.

    Raises:
        MethodError: A field is not sound, or the name is taken within the task.
    """

    task: str
    name: str
    cost_s: float
    evidence: str
    bounds: Sequence[Bound] = ()
    valid: Mapping[str, Range] = field(default_factory=dict)
    fails: str = ""
    survivor: str = ""
    reference: str = ""
    target: Any = None

    def __post_init__(self) -> None:
        what = f"method '{self.name}' of task '{self.task}'"
        if not _NAME.fullmatch(self.name):
            raise MethodError(f"{what}: a name is of letters, digits, _, - and ., and not 'auto'")
        if not 0.0 < self.cost_s < math.inf:
            raise MethodError(f"{what} costs {self.cost_s:g} s; give the seconds of one use")
        if not self.evidence.strip():
            raise MethodError(f"{what} has no evidence; say where its errors were established")
        if self.survivor == self.name:
            raise MethodError(f"{what} cannot survive where it fails itself; name another survivor, or none")
        _check_ranges(self.valid, what)
        for within in (self.valid, *(bound.within for bound in self.bounds)):
            require_declared(within, what)

    def __call__(self, target: T) -> T:
        """Declare the decorated function or class."""
        taken = _REGISTER.get((self.task, self.name))
        place = target.__module__, target.__qualname__  # type: ignore[attr-defined]
        if taken is not None and place != (taken.target.__module__, taken.target.__qualname__):
            what = f"method '{self.name}' of task '{self.task}'"
            raise MethodError(f"{what} is declared twice, first in {taken.module}")
        _REGISTER[self.task, self.name] = replace(self, target=target)
        return target

    def bound(self, output: str, scene: Quantities) -> float | None:
        """Return the smallest stated error of ``output`` in ``scene``, or None where none is stated."""
        if _strays(self.valid, scene):
            return None
        errors = [b.error for b in self.bounds if b.output == output and b.holds(scene)]
        return min(errors, default=None)

    def strayed(self, scene: Quantities) -> str:
        """Return which quantities lie outside the valid range, in words; empty if none does."""
        return ", ".join(_strays(self.valid, scene))

    def missed(self, output: str, scene: Quantities) -> str:
        """Return which quantities keep the scene out of the nearest range of a stated error, in words."""
        coarsest_first = sorted(self.bounds, key=lambda bound: -bound.error)
        strays = [_strays(bound.within, scene) for bound in coarsest_first if bound.output == output]
        nearest: list[str] = min(strays, key=len, default=[])
        return ", ".join(_strays(self.valid, scene) or nearest)

    @property
    def what(self) -> str:
        """The first line of its code's docstring."""
        first = (inspect.getdoc(self.target) or "").partition("\n")[0]
        return _ROLE.sub(r"\1", first)

    @property
    def module(self) -> str:
        return str(self.target.__module__)


method = Method
_REGISTER: dict[tuple[str, str], Method] = {}
_TASKS: dict[str, Task] = {}
_BROKEN: dict[tuple[str, str], str] = {}  # by task and module: why it could not be imported


def declare_task(name: str, question: str, *, per: str, output: str, tolerance: float) -> None:
    """Declare a task, in the module that its methods are declared in or below; see :class:`Task`."""
    made = Task(name, question, per, output, tolerance)
    if _TASKS.setdefault(name, made) != made:
        raise MethodError(f"task '{name}' is declared twice")


def tasks() -> list[Task]:
    """Return every task there is, by name."""
    for name in sorted({*(point.name for point in _points()), *_TASKS}):
        _load(name)
    return sorted(_TASKS.values(), key=lambda task: task.name)


def task(name: str) -> Task:
    """Return a task by name; the error lists those there are."""
    _load(name)
    if name not in _TASKS and (left := names(name)):
        raise MethodError(
            f"task '{name}' has methods ({', '.join(left)}), but no declaration; "
            f"call declare_task('{name}', ...) beside them"
        )
    if name not in _TASKS:
        raise MethodError(f"no task '{name}'; there are {', '.join(task.name for task in tasks())}")
    return _TASKS[name]


def methods(task: str) -> list[Method]:
    """Return the methods of a task, cheapest first, without those of a broken package: :func:`left_out`."""
    _load(task)
    own = (method for method in _REGISTER.values() if method.task == task)
    found = sorted(own, key=lambda method: (method.cost_s, method.name))
    if not found and (why := left_out(task)):
        raise MethodError("; ".join(why))
    return found


def left_out(task: str = "") -> list[str]:
    """Return why methods of a task are missing; of no task, of all to which other packages bring methods."""
    others = {point.name for point in _points() if not point.value.startswith(_PALP)}
    for name in (wanted := [task] if task else sorted(others)):
        _load(name)
    return [why for (of, _), why in _BROKEN.items() if of in wanted]


def names(task: str) -> list[str]:
    """Return the names of a task's methods, cheapest first."""
    return [method.name for method in methods(task)]


def find(task: str, name: str) -> Method:
    """Return one method by name; ``package.module:name`` imports that module first, which declares it."""
    module, _, local = name.rpartition(":")
    if module:
        _import(module, f"method '{name}'")
    _load(task)
    if (task, local) not in _REGISTER:
        lack = "".join(f"; {why}" for why in left_out(task))
        known = ", ".join(sorted(name for of, name in _REGISTER if of == task)) or "none"
        raise MethodError(f"no method '{name}' for task '{task}'; declared: {known}{lack}")
    return _REGISTER[task, local]


@contextmanager
def at_work(declared: Method) -> Iterator[None]:
    """Let an error of the code within name the method."""
    try:
        yield
    except Exception as error:
        error.add_note(f"{declared.task} method '{declared.name}' of {declared.module} was at work")
        raise


def outside(task: str, name: str, scene: Quantities) -> str:
    """Return which quantities of a scene lie outside a method's valid range, in words; empty if none."""
    declared = find(task, name)
    advice = f"; {declared.survivor} survives there" if declared.survivor else ""
    strayed = declared.strayed(scene)
    return f"{name} is outside its valid range: {strayed}{advice}" if strayed else ""


@cache
def _points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=GROUP))


def _load(task: str) -> None:
    for point in _points():
        if point.name == task and (task, point.value) not in _BROKEN:
            try:
                _import(point.value, f"the methods of task '{task}'", point)
            except MethodError as error:
                _BROKEN[task, point.value] = str(error)


def _import(module: str, what: str, point: EntryPoint | None = None) -> None:
    before = set(_REGISTER)
    try:
        importlib.import_module(module)
    except Exception as error:
        for half in set(_REGISTER) - before:  # what a module declared before it broke off is not whole
            if _REGISTER[half].module not in sys.modules:
                del _REGISTER[half]
        of = f", an entry point of package '{point.dist.name}'," if point and point.dist else ""
        kind = "" if isinstance(error, ImportError | PalpError) else f"{type(error).__name__}: "
        raise MethodError(f"{what}: {module}{of} cannot be imported: {kind}{error}") from error


def _check_ranges(within: Mapping[str, Range], what: str) -> None:
    for name, (low, high) in within.items():
        if not low <= high:
            raise MethodError(f"{what} holds for {name} in [{low:g}, {high:g}], which is nowhere")


def _strays(within: Mapping[str, Range], scene: Quantities) -> list[str]:
    return [
        f"{name} = {in_words(scene[name])} is not in [{low:g}, {high:g}]"
        for name, (low, high) in within.items()
        if name in scene and not all(low <= value <= high for value in _values(scene[name]))
    ]


def in_words(quantity: float | Iterable[float]) -> str:
    """Return a scene's quantity, one value or several, as text."""
    return " and ".join(f"{value:g}" for value in _values(quantity))


def _values(quantity: float | Iterable[float]) -> tuple[float, ...]:
    return (quantity,) if isinstance(quantity, int | float) else tuple(quantity)
