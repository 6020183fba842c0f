"""A case of stability: a method that fails in a scene, its symptom and threshold, and what survives."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.units import Float64Array

_QUICK = 8  # values tried of a parameter that is varied quickly
HEAD = ("method", "scene", "symptom", "fails at", "survivor", "test")


@dataclass(frozen=True, eq=False)
class Case:
    """A method that fails and one that survives, given the same."""

    name: str  # of it, as in pytest -k NAME
    method: str  # the method that fails
    survivor: str  # the method that does not
    scene: str  # what both are given
    symptom: str  # what is wrong: measured, with its unit, where a parameter is varied
    of_method: Callable[..., Any]  # symptom at a value of the parameter, or answer to the one input
    of_survivor: Callable[..., Any]
    limit: float | Callable[[Any], bool]  # symptom from which on it fails, or whether an answer is right
    why: str = ""  # what happens, in a sentence; empty: what both answer
    answer: str = "{}"  # how an answer is written
    parameter: str = ""  # what is varied, with its unit; empty: nothing
    values: Float64Array = field(default_factory=lambda: np.zeros(1))  # of the parameter, shape (n,)
    scale: float = 1.0  # tables show the parameter times this
    # values of the parameter that the published rig has, as shown; none where it is no quantity of the rig
    rig: tuple[float, ...] = ()

    def tried(self, *, quick: bool) -> Float64Array:
        """Return the values that are tried."""
        count = min(self.values.size, _QUICK) if quick else self.values.size
        return np.asarray(self.values[np.linspace(0, self.values.size - 1, count).round().astype(int)])


@dataclass(frozen=True)
class Symptoms:
    """What both methods of a case show."""

    of_method: tuple[float, ...]  # at each value tried; infinite where it gave no answer at all
    of_survivor: tuple[float, ...]
    why: str


def measure(case: Case, *, quick: bool = False) -> Symptoms:
    """Run both methods of a case; an error that a method raises is its answer, and no warning is shown."""
    ways = case.of_method, case.of_survivor
    if not callable(case.limit):
        found = [[_symptom(way, float(value)) for value in case.tried(quick=quick)] for way in ways]
        return Symptoms(tuple(found[0]), tuple(found[1]), case.why)
    answers = [_answer(way) for way in ways]
    wrong = [float(not case.limit(one)) for one in answers]
    naive, ours = (_words(one, case.answer) for one in answers)
    return Symptoms((wrong[0],), (wrong[1],), f"Gives {naive}; the survivor {ours}.")


def _symptom(way: Callable[[float], float], value: float) -> float:
    try:
        return float(way(value))
    except MechanicsError:
        return np.inf


def _answer(way: Callable[[], Any]) -> Any:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            return way()
        except Exception as error:  # noqa: BLE001  whatever the naive way runs into is what is to be shown
            return error


def _words(found: Any, form: str) -> str:
    if isinstance(found, Exception):
        return f"{type(found).__name__}: {found}"
    if isinstance(found, np.ndarray):
        return np.array2string(found, precision=3, suppress_small=True)
    return form.format(f"{found:.3g}" if isinstance(found, float) else found)


@dataclass(frozen=True, eq=False)
class Row:
    """A row of the stability table: a case and what was measured."""

    case: Case
    values: Float64Array  # of the parameter, as shown, shape (n,)
    of_method: Float64Array  # symptoms, shape (n,)
    of_survivor: Float64Array
    why: str

    @classmethod
    def of(cls, case: Case, found: Symptoms, *, quick: bool = False) -> "Row":
        """Return the row of a case that was measured."""
        values = case.tried(quick=quick) * case.scale
        return cls(case, values, np.array(found.of_method), np.array(found.of_survivor), found.why)

    @property
    def limit(self) -> float:
        """Symptom from which on a value fails."""
        return 0.5 if callable(self.case.limit) else self.case.limit

    @property
    def failed(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Where the method fails."""
        return ~(self.of_method < self.limit)

    @property
    def fails_somewhere(self) -> bool:
        """Whether the method fails anywhere in what was tried."""
        return bool(self.failed.any())

    @property
    def survived(self) -> bool:
        """Whether the survivor stays below the limit everywhere."""
        return bool(np.all(self.of_survivor < self.limit))

    @property
    def fails_at_the_rig(self) -> bool:
        """Whether it fails at the value that was tried next to one of the published rig's; none is beyond."""
        tried = [at for at in self.case.rig if self.values[0] <= at <= self.values[-1]]
        return any(bool(self.failed[int(np.argmin(np.abs(self.values - at)))]) for at in tried)

    @property
    def cells(self) -> tuple[str, ...]:
        """The row's cells, under :data:`HEAD`."""
        case, symptom, threshold, survivor = self.case, self.case.symptom, "this input", self.case.survivor
        if case.parameter:
            symptom = f"{symptom}: {self.limit:g} and more"
            threshold = (
                f"{case.parameter}: {self.threshold} (tried: {self.values[0]:.5g} to {self.values[-1]:.5g})"
            )
            worst = float(np.max(self.of_survivor))  # round-off is no symptom
            survivor = f"{survivor} (at most {worst if worst > 1e-6 * self.limit else 0.0:.1g})"
        return case.method, case.scene, symptom, threshold, survivor, case.name

    @property
    def threshold(self) -> str:
        """Where the method fails, in words."""
        failed = self.failed
        if failed.all():
            return "everywhere in the range"
        if not failed.any():
            return "nowhere in the range"
        flips = np.flatnonzero(failed[1:] != failed[:-1])
        if len(flips) == 1:
            at = int(flips[0])
            return f"from {self.values[at + 1]:.3g}" if failed[-1] else f"up to {self.values[at]:.3g}"
        edges = np.flatnonzero(np.diff(np.concatenate([[False], failed, [False]]).astype(int)))
        spans = zip(edges[0::2], edges[1::2] - 1, strict=True)
        return ", ".join(f"{self.values[first]:.4g} to {self.values[last]:.4g}" for first, last in spans)
