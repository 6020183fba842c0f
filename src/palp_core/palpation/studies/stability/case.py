"""A case of stability: a method that fails, by which symptom, from where on, and what survives there."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class Case:
    """Symptom of a failing method and of the survivor over the same range."""

    name: str  # of it, as in pytest -k NAME
    failing: str  # the method that fails
    survivor: str  # the method that does not
    parameter: str  # what is varied, with its unit; of a case with one input, that input in words
    values: Float64Array  # of the parameter, shape (n,); one where nothing is varied
    symptom: str  # what is measured, with its unit
    # symptom of the failing method, shape (n,); infinite where it gave no answer at all
    of_failing: Float64Array
    of_survivor: Float64Array  # symptom of the survivor, shape (n,)
    limit: float  # symptom from which on a value counts as failed
    why: str  # what happens, in a sentence
    # of the parameter: linear, log, or to_half, which spreads what is just below 0.5
    axis: Literal["linear", "log", "to_half"] = "linear"
    # values of the parameter that the published rig has; none where it is no quantity of the rig
    rig: tuple[float, ...] = ()

    @property
    def failed(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Where the failing method fails."""
        return ~(self.of_failing < self.limit)

    @property
    def survived(self) -> bool:
        """Whether the survivor stays below the limit over the whole range."""
        return bool(np.all(self.of_survivor < self.limit))

    @property
    def fails_somewhere(self) -> bool:
        """Whether the failing method fails anywhere in what was tried."""
        return bool(self.failed.any())

    @property
    def fails_at_the_rig(self) -> bool:
        """Whether it fails at the value that was tried next to one of the published rig's; none is beyond."""
        tried = [at for at in self.rig if self.values[0] <= at <= self.values[-1]]
        return any(bool(self.failed[int(np.argmin(np.abs(self.values - at)))]) for at in tried)

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Failing method, symptom with its limit, where it fails of what was tried, survivor; in words."""
        if self.values.size == 1:
            return self.failing, self.symptom, self.parameter, self.survivor
        least, most = (f"{end:.5g}" for end in (self.values[0], self.values[-1]))
        worst = float(np.max(self.of_survivor))
        most_left = f"{worst:.1g}" if worst > 1e-6 * self.limit else "0"  # round-off is no symptom
        return (
            self.failing,
            f"{self.symptom}: {self.limit:g} and more",
            f"{self.parameter}: {self.threshold} (tried: {least} to {most})",
            f"{self.survivor} (there at most {most_left})",
        )

    @property
    def threshold(self) -> str:
        """Where the failing method fails, in words."""
        failed = self.failed
        if failed.all():
            return "everywhere in the range"
        if not failed.any():
            return "nowhere in the range"
        flips = np.flatnonzero(failed[1:] != failed[:-1])
        if len(flips) == 1:
            at = int(flips[0])
            side = "from" if failed[-1] else "up to"
            return f"{side} {self.values[at + 1 if failed[-1] else at]:.3g}"
        edges = np.flatnonzero(np.diff(np.concatenate([[False], failed, [False]]).astype(int)))
        spans = zip(edges[0::2], edges[1::2] - 1, strict=True)
        return ", ".join(f"{self.values[first]:.4g} to {self.values[last]:.4g}" for first, last in spans)


def measure(
    name: str,
    failing: str,
    survivor: str,
    parameter: str,
    values: Float64Array,
    symptom: str,
    of_failing: Callable[[float], float],
    of_survivor: Callable[[float], float],
    limit: float,
    why: str,
    *,
    scale: float = 1.0,
    **more: Any,
) -> Case:
    """Return a case whose symptoms are measured at every value; the table shows values times ``scale``."""
    bad, good = (np.array([of(float(value)) for value in values]) for of in (of_failing, of_survivor))
    return Case(name, failing, survivor, parameter, values * scale, symptom, bad, good, limit, why, **more)


def compare_once(
    name: str,
    symptom: str,
    given: str,
    failing: str,
    survivor: str,
    naive: Callable[[], Any],
    ours: Callable[[], Any],
    survives: Callable[[Any], bool],
    words: Callable[[Any], str],
) -> Case:
    """Return a case with one input: what both methods answer to it."""
    found = [answer(naive), answer(ours)]
    wrong = [np.full(1, float(not survives(one))) for one in found]
    spoken = [f"{type(one).__name__}: {one}" if isinstance(one, Exception) else words(one) for one in found]
    why = f"Gives {spoken[0]}; the survivor {spoken[1]}."
    return Case(name, failing, survivor, given, np.zeros(1), symptom, wrong[0], wrong[1], 0.5, why)


def answer(way: Callable[[], Any]) -> Any:
    """Return what a method answers; an error that it raises is its answer too, and no warning is shown."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            return way()
        except Exception as error:  # noqa: BLE001  whatever the naive way runs into is what is to be shown
            return error
