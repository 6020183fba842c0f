"""What there is to choose from: tasks, and the methods declared for each."""

import importlib
import inspect
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
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
"""Entry points by task: the modules that declare its methods, imported when somebody asks for one."""

# A parameter's `auto` leaves it to the register, and a colon parts a name from its module.
_NAME = re.compile(r"(?!auto$)\w[\w.-]*")

_PALP = "palp_core."
_EACH_OTHER = 2  # that survive where the other fails; a longer way round leads nowhere

_ROLE = re.compile(r":\w+:`[.~]*([^`]*)`|``")  # of a docstring's words, not for people


@dataclass(frozen=True)
class Task:
    """Something that can be done in several ways.

    Attributes:
        name: As in ``contact``.
        question: What its methods answer, in words.
        per: What the cost of a method is for, as in ``a sweep of 4000 samples``.
        output: What must be right where nobody says.
        tolerance: How right, where nobody says; as the bounds of its methods count.
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
        within: Inclusive range per declared quantity; one that the scene does not tell is not checked.
    """

    output: str
    error: float
    within: Mapping[str, Range] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse what bounds nothing.

        Raises:
            MethodError: The error is negative, infinite or NaN, or a range has no inside.
        """
        if not 0.0 <= self.error < math.inf:
            raise MethodError(
                f"a bound on '{self.output}' of {self.error:g} is none; give the largest error seen"
            )
        _check_ranges(self.within, f"a bound on '{self.output}'")

    def holds(self, scene: Quantities) -> bool:
        """Tell whether every named quantity of the scene lies in its range, all its values if several."""
        return not _strays(self.within, scene)


@dataclass(frozen=True)
class Method:
    """One declared method: what it does, what it costs, how wrong it is, and where it fails.

    Attributes:
        task: What it is exchangeable for.
        name: Its name within the task.
        target: The function or class.
        cost_s: Seconds of one core for one use, on the machine whose unit is
            :data:`palp_core.methods.machine.UNIT_S`; orders the choice.
        bounds: Stated errors.
        evidence: Where they were established.
        valid: Range per scene quantity outside which it must not be used at all.
        fails: What happens beyond.
        survivor: Name of the method of the same task to use there.
        reference: Why it is declared though never chosen; empty: it can be.
    """

    task: str
    name: str
    target: Any
    cost_s: float
    bounds: tuple[Bound, ...]
    evidence: str
    valid: Mapping[str, Range]
    fails: str
    survivor: str
    reference: str = ""

    def bound(self, output: str, scene: Quantities) -> float | None:
        """Return the smallest stated error of ``output`` in ``scene``, or None where none is vouched for."""
        if _strays(self.valid, scene):
            return None
        errors = [b.error for b in self.bounds if b.output == output and b.holds(scene)]
        return min(errors, default=None)

    def strayed(self, scene: Quantities) -> str:
        """Return which quantities lie outside the valid range, in words; empty if none does."""
        return ", ".join(_strays(self.valid, scene))

    def missed(self, output: str, scene: Quantities) -> str:
        """Return which quantities keep the scene out of the nearest range of a stated error, in words."""
        coarsest_first = sorted(self.bounds, key=lambda one: -one.error)
        strays = [_strays(one.within, scene) for one in coarsest_first if one.output == output]
        nearest = sorted(strays, key=len)[0] if strays else []
        return ", ".join(_strays(self.valid, scene) or nearest)

    @property
    def what(self) -> str:
        """What it is, in words: the first line of what its code says of itself."""
        first = (inspect.getdoc(self.target) or "").partition("\n")[0]
        return _ROLE.sub(r"\1", first)

    @property
    def module(self) -> str:
        """Module that declares it."""
        return str(self.target.__module__)


_REGISTER: dict[tuple[str, str], Method] = {}
_TASKS: dict[str, Task] = {}
_BROKEN: dict[tuple[str, str], str] = {}  # by task and module: why it could not be imported


def declare_task(name: str, question: str, *, per: str, output: str, tolerance: float) -> None:
    """Declare a task, in the module that its methods are declared in or below; see :class:`Task`.

    Raises:
        MethodError: It is declared already, as something else.
    """
    made = Task(name, question, per, output, tolerance)
    if _TASKS.setdefault(name, made) != made:
        raise MethodError(f"task '{name}' is declared twice")


def method(
    *,
    task: str,
    name: str,
    cost_s: float,
    evidence: str,
    bounds: Sequence[Bound] = (),
    valid: Mapping[str, Range] | None = None,
    fails: str = "",
    survivor: str = "",
    reference: str = "",
) -> Callable[[T], T]:
    """Declare the decorated function or class as a method of ``task``.

    Args:
        task: What it is exchangeable for, as in ``contact``, ``denoise``, ``stop``.
        name: Its name within the task.
        cost_s: Seconds of one core for one use; orders the choice.
        evidence: Where the stated errors were established.
        bounds: Stated errors, each with the scenes in which it holds.
        valid: Range per scene quantity outside which the method must not be used at all.
        fails: What happens beyond that range.
        survivor: Name of the method of the same task to use there.
        reference: Why it is declared though it is never chosen, as for a method kept to show where it fails.

    Raises:
        MethodError: The name is already taken within the task or is none, the cost is not positive and
            finite, there is no evidence, a range has no inside or is of a quantity that nobody declared, or
            the method is its own survivor.
    """
    what = f"method '{name}' of task '{task}'"
    if not _NAME.fullmatch(name):
        raise MethodError(f"{what}: a name is of letters, digits, _, - and ., and not 'auto'")
    if not 0.0 < cost_s < math.inf:
        raise MethodError(f"{what} costs {cost_s:g} s; give the seconds of one use")
    if not evidence.strip():
        raise MethodError(f"{what} has no evidence; say where its errors were established")
    if survivor == name:
        raise MethodError(f"{what} cannot survive where it fails itself; name another survivor, or none")
    _check_ranges(valid or {}, what)
    for within in (valid or {}, *(bound.within for bound in bounds)):
        require_declared(within, what)

    def declare(target: T) -> T:
        taken = _REGISTER.get((task, name))
        if taken is not None and taken.target is not target and _place(taken.target) != _place(target):
            raise MethodError(f"{what} is declared twice, first in {taken.module}")
        _REGISTER[task, name] = Method(
            task, name, target, cost_s, tuple(bounds), evidence, dict(valid or {}), fails, survivor, reference
        )
        return target

    return declare


def _check_ranges(within: Mapping[str, Range], what: str) -> None:
    for name, (low, high) in within.items():
        if not low <= high:
            raise MethodError(f"{what} holds for {name} in [{low:g}, {high:g}], which is nowhere")


def _place(target: Any) -> tuple[str, str]:
    return target.__module__, target.__qualname__


def tasks() -> list[Task]:
    """Return every task there is, by name."""
    for name in sorted({*(point.name for point in _points()), *_TASKS}):
        _load(name)
    return sorted(_TASKS.values(), key=lambda one: one.name)


def task(name: str) -> Task:
    """Return a task by name.

    Raises:
        MethodError: There is none of that name; the message lists those there are.
    """
    _load(name)
    if name not in _TASKS and (left := names(name)):
        raise MethodError(
            f"task '{name}' has methods ({', '.join(left)}), but nobody says what it is; "
            f"call declare_task('{name}', ...) beside them"
        )
    if name not in _TASKS:
        raise MethodError(f"no task '{name}'; there are {', '.join(one.name for one in tasks())}")
    return _TASKS[name]


def methods(task: str) -> list[Method]:
    """Return the methods of a task, cheapest first; what is broken is left out, see :func:`left_out`.

    Raises:
        MethodError: None is left, as what declares them is broken.
    """
    _load(task)
    found = _sound(_own(task))
    if not found and (why := _left_out(task)):
        raise MethodError("; ".join(why))
    return found


def left_out(task: str = "") -> list[str]:
    """Return in words what a task's methods lack, and why: a broken package leaves the others theirs.

    Args:
        task: The task; empty: every one to which packages beside palp itself bring methods.
    """
    every = {point.name for point in _points() if not point.value.startswith(_PALP)}
    every |= {one.task for one in _REGISTER.values() if not one.module.startswith(_PALP)}
    found = []
    for name in [task] if task else sorted(every):
        _load(name)
        found += _left_out(name)
    return found


def _left_out(task: str) -> list[str]:
    own = _own(task)
    broken = [why for (of, _), why in _BROKEN.items() if of == task]
    return broken + [why for one in own.values() if (why := _leads_nowhere(one, own))]


def _own(task: str) -> dict[str, Method]:
    return {one.name: one for one in _REGISTER.values() if one.task == task}


def _sound(own: Mapping[str, Method]) -> list[Method]:
    found = (one for one in own.values() if not _leads_nowhere(one, own))
    return sorted(found, key=lambda m: (m.cost_s, m.name))


def _leads_nowhere(one: Method, own: Mapping[str, Method]) -> str:
    """Return why a method's survivors lead nowhere, in words; empty if they end or are each other's."""
    way = [one.name]
    while survivor := own[way[-1]].survivor:
        if survivor not in own:
            words = f"'{survivor}', which is no method of the task"
        elif survivor not in way:
            way.append(survivor)
            continue
        elif len(way) - way.index(survivor) <= _EACH_OTHER:
            return ""
        else:
            words = f"'{survivor}' again"
        lead = f"method '{one.name}' of task '{one.task}', declared in {one.module}"
        return f"{lead}: its survivors lead nowhere: {' -> '.join(way)} -> {words}"
    return ""


def names(task: str) -> list[str]:
    """Return the names of a task's methods, cheapest first."""
    return [one.name for one in methods(task)]


def find(task: str, name: str) -> Method:
    """Return one method by name.

    Args:
        task: What it is for.
        name: Its name; ``package.module:name`` imports that module first, which declares it.

    Raises:
        MethodError: There is none of that name, or its survivors lead nowhere; the message lists those there
            are, and what is broken.
    """
    module, _, local = name.rpartition(":")
    if module:
        _import(module, f"method '{name}'")
    _load(task)
    own = _own(task)
    if local not in own:
        lack = "".join(f"; {why}" for why in _left_out(task))
        known = ", ".join(one.name for one in _sound(own)) or "none"
        raise MethodError(f"no method '{name}' for task '{task}'; declared: {known}{lack}")
    if why := _leads_nowhere(own[local], own):
        raise MethodError(why)
    return own[local]


@contextmanager
def at_work(declared: Method) -> Iterator[None]:
    """Let an error of the code within say which method was at work."""
    try:
        yield
    except Exception as error:
        error.add_note(f"{declared.task} method '{declared.name}' of {declared.module} was at work")
        raise


def outside(task: str, name: str, scene: Quantities) -> str:
    """Return which quantities of a scene lie outside a method's valid range, in words; empty if none."""
    declared = find(task, name)
    strayed = declared.strayed(scene)
    if not strayed:
        return ""
    advice = f"; {declared.survivor} survives there" if declared.survivor else ""
    return f"{name} is outside its valid range: {strayed}{advice}"


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


def _strays(within: Mapping[str, Range], scene: Quantities) -> list[str]:
    return [
        f"{name} = {_one(scene[name])} is not in [{low:g}, {high:g}]"
        for name, (low, high) in within.items()
        if name in scene and not all(low <= value <= high for value in values_of(scene[name]))
    ]


def _one(quantity: float | tuple[float, ...]) -> str:
    return " and ".join(f"{value:g}" for value in values_of(quantity))


def values_of(quantity: float | Iterable[float]) -> tuple[float, ...]:
    """Return the values of a scene's quantity, one or several."""
    return (quantity,) if isinstance(quantity, int | float) else tuple(quantity)
