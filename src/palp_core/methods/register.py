"""What there is to choose from: tasks and their methods, the rows of tables."""

import difflib
import importlib
import inspect
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

from palp_core.errors import MethodError, PalpError
from palp_core.published import published

Range = tuple[float, float]
"""Least and largest value of a quantity, both included."""

Quantities = Mapping[str, float | tuple[float, ...]]
"""Quantities of a scene by name, SI; one value, or several that all occur."""

OWN = "palp_core.palpation.method_table"
"""palp's own table."""

GROUP = "palp.methods"
"""Entry points of other packages: modules with ``METHODS``, and ``TASKS`` and ``QUANTITIES`` of their own."""

# A parameter's `auto` leaves it to the register, and a colon parts a name from its module.
_NAME = re.compile(r"(?!auto$)\w[\w.-]*")
_ROLE = re.compile(r":\w+:`[.~]*([^`]*)`|``")  # of a docstring's words, not for people


@dataclass(frozen=True, kw_only=True)
class Task:
    """Something that can be done in several ways.

    Attributes:
        name: As in ``contact``.
        question: What its methods answer.
        per: What the cost of a method is for, as in ``a sweep of 4000 samples``.
        output: What must be right unless the scene says otherwise.
        tolerance: How right; as the bounds of its methods count.
        measure: Function for ``palp methods measure``, as ``package.module:name``; empty: there is none.
    """

    name: str
    question: str
    per: str
    output: str
    tolerance: float
    measure: str = ""


@dataclass(frozen=True)
class Bound:
    """A stated error of one output, and the scenes in which it holds.

    Attributes:
        output: What the bound is about, as in ``peak`` or ``contrast``.
        error: Largest error; relative, dimensionless, unless the task's output says otherwise.
        within: Inclusive range per quantity; one that the scene does not have is not checked.

    Raises:
        MethodError: The error is negative, infinite or NaN, or a range has no inside.
    """

    output: str
    error: float
    within: Mapping[str, Range] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0.0 <= self.error < math.inf:
            raise MethodError(
                f"bound on '{self.output}': its error is {self.error:g}; give the largest error seen"
            )
        _check_ranges(self.within, f"bound on '{self.output}'")

    def holds(self, scene: Quantities) -> bool:
        return not _strays(self.within, scene)


@dataclass(frozen=True, kw_only=True)
class Method:
    """One method: what it does, what it costs, how wrong it is, and where it fails.

    Attributes:
        task: What it is exchangeable for, as in ``contact``, ``denoise``, ``stop``.
        name: Its name within the task.
        place: Its function or class, as ``package.module:name``; imported when it is used.
        cost_s: Seconds of one core for one use, on the machine whose unit is
            :data:`palp_core.methods.measured.UNIT_S`; orders the choice.
        evidence: Where the stated errors were established.
        bounds: Stated errors, each with the scenes in which it holds.
        valid: Range per scene quantity outside which the method must not be used at all.
        fails: What happens beyond that range.
        survivor: Name of the method of the same task to use there.
        reference: Why it is listed though it is never chosen, as for a method kept to show where it fails.

    Raises:
        MethodError: A field is not sound.
    """

    task: str
    name: str
    place: str
    cost_s: float
    evidence: str
    bounds: Sequence[Bound] = ()
    valid: Mapping[str, Range] = field(default_factory=dict)
    fails: str = ""
    survivor: str = ""
    reference: str = ""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise MethodError(f"{self}: a name is of letters, digits, _, - and ., and not 'auto'")
        if not 0.0 < self.cost_s < math.inf:
            raise MethodError(f"{self} costs {self.cost_s:g} s; give the seconds of one use")
        if not self.evidence.strip():
            raise MethodError(f"{self} has no evidence; name the test or study of its errors")
        if self.survivor == self.name:
            raise MethodError(f"{self} cannot survive where it fails itself; name another survivor, or none")
        _check_ranges(self.valid, str(self))

    def __str__(self) -> str:
        return f"method '{self.name}' of task '{self.task}'"

    @cached_property
    def target(self) -> Any:
        """The function or class."""
        return load(self.place, str(self))

    @property
    def module(self) -> str:
        return self.place.partition(":")[0]

    @property
    def what(self) -> str:
        """The first line of its code's docstring."""
        first = (inspect.getdoc(self.target) or "").partition("\n")[0]
        return _ROLE.sub(r"\1", first)

    def bound(self, output: str, scene: Quantities) -> float | None:
        """Return the smallest stated error of ``output`` in ``scene``, or None where none is stated."""
        if _strays(self.valid, scene):
            return None
        errors = [b.error for b in self.bounds if b.output == output and b.holds(scene)]
        return min(errors, default=None)

    def missed(self, output: str, scene: Quantities) -> str:
        """Return which quantities keep the scene out of the nearest range of a stated error, as text."""
        coarsest_first = sorted(self.bounds, key=lambda bound: -bound.error)
        strays = [_strays(bound.within, scene) for bound in coarsest_first if bound.output == output]
        nearest: list[str] = min(strays, key=len, default=[])
        return ", ".join(_strays(self.valid, scene) or nearest)


class Register:
    """The rows of tables: all of a table, or none."""

    def __init__(self) -> None:
        self.tasks: dict[str, Task] = {}
        self.methods: dict[tuple[str, str], Method] = {}
        self.quantities: dict[str, tuple[str, str]] = {}
        self.left_out: list[str] = []  # why tables of other packages are missing

    def read(self, module: str) -> None:
        """Add the rows of a module."""
        self.add(load(module, "table of methods"), module)

    def add(self, table: Any, place: str) -> None:
        """Add the rows of a table; one that is there already stays."""
        if not hasattr(table, "METHODS"):
            raise MethodError(f"{place}: it has no METHODS; list its methods there")
        made = Register()
        made.tasks, made.methods = dict(self.tasks), dict(self.methods)
        made.quantities = dict(self.quantities)
        for name, known in getattr(table, "QUANTITIES", {}).items():
            if made.quantities.setdefault(name, known) != known:
                meaning, unit = reversed(made.quantities[name])
                raise MethodError(f"{place}: quantity '{name}' is listed already: {meaning} ({unit})")
        for one in getattr(table, "TASKS", ()):
            if made.tasks.setdefault(one.name, one) != one:
                raise MethodError(f"{place}: task '{one.name}' is listed twice; name it otherwise")
        for row in table.METHODS:
            first = made.methods.setdefault((row.task, row.name), row)
            if first != row:
                raise MethodError(f"{place}: {row} is listed twice, first at {first.place}; rename one")
            made.task(row.task, f"{place}: ")
            for within in (row.valid, *(bound.within for bound in row.bounds)):
                made.require_quantities(within, f"{place}: {row}")
        self.tasks, self.methods, self.quantities = made.tasks, made.methods, made.quantities

    def task(self, name: str, asked_by: str = "") -> Task:
        if name not in self.tasks:
            raise MethodError(f"{asked_by}no task '{name}'; there are {', '.join(sorted(self.tasks))}")
        return self.tasks[name]

    def require_quantities(self, names: Iterable[str], what: str) -> None:
        """Refuse names that are no quantities: a range in one would be checked in no scene."""
        for name in names:
            if name not in self.quantities:
                near = difflib.get_close_matches(name, self.quantities, n=3)
                meant = f"did you mean {' or '.join(near)}? " if near else ""
                raise MethodError(f"{what}: '{name}' is not a quantity; {meant}add it to QUANTITIES")


@cache
def register() -> Register:
    """Return the register of this process: palp's own table, then those of other packages."""
    found = Register()
    found.read(OWN)
    for module in published(GROUP).values():
        try:
            found.read(module)
        except MethodError as error:
            found.left_out.append(str(error))
    return found


def tasks() -> list[Task]:
    """Return every task there is, by name."""
    return sorted(register().tasks.values(), key=lambda task: task.name)


def task(name: str) -> Task:
    """Return a task by name; the error lists those there are."""
    return register().task(name)


def quantities() -> dict[str, tuple[str, str]]:
    """Return SI unit (``1`` where it has none) and meaning of what scenes can name, by name."""
    return dict(register().quantities)


def methods(task: str) -> list[Method]:
    """Return the methods of a task, cheapest first."""
    own = (method for method in register().methods.values() if method.task == task)
    return sorted(own, key=lambda method: (method.cost_s, method.name))


def names(task: str) -> list[str]:
    """Return the names of a task's methods, cheapest first."""
    return [method.name for method in methods(task)]


def left_out() -> list[str]:
    """Return the reasons why methods of other packages are missing."""
    return list(register().left_out)


def find(task: str, name: str) -> Method:
    """Return one method by name; of ``package.module:name`` that module's table is read first."""
    module, _, local = name.rpartition(":")
    if module:
        register().read(module)
    found = register().methods.get((task, local))
    if found is None:
        known = ", ".join(sorted(names(task))) or "none"
        lack = "".join(f"; left out: {why}" for why in left_out())
        raise MethodError(f"no method '{name}' for task '{task}'; there are {known}{lack}")
    return found


@contextmanager
def errors_name(method: Method) -> Iterator[None]:
    """Add the method's name to errors of the code within."""
    try:
        yield
    except Exception as error:
        error.add_note(f"in {method.task} method '{method.name}' of {method.module}")
        raise


def outside(task: str, name: str, scene: Quantities) -> str:
    """Return which quantities of a scene lie outside a method's valid range, as text; empty if none."""
    found = find(task, name)
    advice = f"; {found.survivor} survives there" if found.survivor else ""
    strayed = ", ".join(_strays(found.valid, scene))
    return f"{name} is outside its valid range: {strayed}{advice}" if strayed else ""


def load(place: str, what: str) -> Any:
    """Import a module, or of ``package.module:name`` what it names; errors begin with ``what``."""
    module, _, attribute = place.partition(":")
    try:
        found = importlib.import_module(module)
        return getattr(found, attribute) if attribute else found
    except Exception as error:
        kind = "" if isinstance(error, ImportError | PalpError) else f"{type(error).__name__}: "
        raise MethodError(f"{what}: {place} cannot be imported: {kind}{error}") from error


def quantity_text(quantity: float | Iterable[float]) -> str:
    """Return a scene's quantity, one value or several, as text."""
    return " and ".join(f"{value:g}" for value in _values(quantity))


def _check_ranges(within: Mapping[str, Range], what: str) -> None:
    for name, (low, high) in within.items():
        if not low <= high:
            raise MethodError(f"{what} holds for {name} in [{low:g}, {high:g}], which is nowhere")


def _strays(within: Mapping[str, Range], scene: Quantities) -> list[str]:
    return [
        f"{name} = {quantity_text(scene[name])} is not in [{low:g}, {high:g}]"
        for name, (low, high) in within.items()
        if name in scene and not all(low <= value <= high for value in _values(scene[name]))
    ]


def _values(quantity: float | Iterable[float]) -> tuple[float, ...]:
    return (quantity,) if isinstance(quantity, int | float) else tuple(quantity)
