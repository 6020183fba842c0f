"""One scene of one task: what the register chose there, what it was worth, and what would have done."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.methods import Quantities, find, methods, weigh

ERRORS = 3.0
"""Standard errors from a limit at which a measured error counts as on one side of it."""

_ROUNDS = 3


@dataclass(frozen=True)
class Reading:
    """A measured error.

    Attributes:
        error: As the bounds of the task count.
        sd: Its standard error; 0 where nothing is left to chance.
    """

    error: float
    sd: float = 0.0

    def within(self, limit: float) -> str:
        """Return ``yes``, ``no``, or ``unclear`` where its standard error leaves it open."""
        room = ERRORS * self.sd
        if self.error + room <= limit:
            return "yes"
        return "no" if not self.error - room <= limit else "unclear"


def mean_reading(values: Any) -> Reading:
    """Return the mean of independent values, of sessions or of repeats, with its standard error."""
    found = np.asarray(values, dtype=np.float64)
    return Reading(float(found.mean()), float(found.std(ddof=1) / math.sqrt(found.size)))


@dataclass(frozen=True)
class Case:
    """A scene as a task sees it.

    Attributes:
        task: The task.
        output: What must be right.
        tolerance: How right.
        quantities: What the register is told.
        measure: Returns the true error of a method; a later round is longer, of other chance.
        words: The scene, for people.
    """

    task: str
    output: str
    tolerance: float
    quantities: Quantities
    measure: Callable[[str, int], Reading]
    words: str = ""


@dataclass
class Verdict:
    """What came of a scene.

    Attributes:
        task: The task.
        index: Which scene.
        output: What had to be right.
        tolerance: How right.
        words: The scene, for people.
        chosen: The register's choice; empty: it refused them all.
        bound: What that stated.
        error: True error of the choice.
        sd: Standard error of that.
        kept: Whether it was within the tolerance: ``yes``, ``no``, ``unclear``; empty if refused.
        stated: Stated bounds that were held against a measured error.
        broken: Those not kept, in words.
        best: The cheapest method whose true error was within the tolerance; empty: none.
        cost_ratio: Declared cost of the choice over that of the best.
    """

    task: str
    index: int
    output: str
    tolerance: float
    words: str
    chosen: str = ""
    bound: float = math.nan
    error: float = math.nan
    sd: float = 0.0
    kept: str = ""
    stated: int = 0
    broken: list[str] = field(default_factory=list)
    best: str = ""
    cost_ratio: float = math.nan

    @property
    def needless(self) -> bool:
        """Whether it was refused although a method would have been right enough."""
        return not self.chosen and bool(self.best)

    def row(self) -> dict[str, Any]:
        """Return it for a table."""
        return asdict(self) | {"broken": "; ".join(self.broken)}


def judge(case: Case, index: int) -> Verdict:
    """Let the register choose, and measure the choice and all that is cheaper; refused, until one would do.

    Raises:
        PalpError: The choice has no answer in the scene.
    """
    offers = weigh(case.task, case.output, case.tolerance, case.quantities)
    chosen = next((one for one in offers if one.mark == "chosen"), None)
    found = Verdict(case.task, index, case.output, case.tolerance, case.words)
    if chosen is not None:
        found.chosen, found.bound = chosen.name, chosen.bound or 0.0
        reading = _measured(case, found, chosen.name, _ROUNDS)
        found.error, found.sd, found.kept = reading.error, reading.sd, reading.within(case.tolerance)
    for one in methods(case.task):
        if one.reference:
            continue
        if one.name == found.chosen:
            break
        try:
            reading = _measured(case, found, one.name, 1)
        except PalpError:
            continue  # it has no answer here, so it would not have done
        if reading.error <= case.tolerance:
            found.best = one.name
            break
    if found.chosen and not found.best and found.kept != "no":
        found.best = found.chosen
    if found.chosen and found.best:
        costs = [find(case.task, name).cost_s for name in (found.chosen, found.best)]
        found.cost_ratio = costs[0] / costs[1]
    return found


def _measured(case: Case, found: Verdict, name: str, rounds: int) -> Reading:
    """Measure a method, longer while chance leaves tolerance or bound open, and hold it against its bound."""
    bound = find(case.task, name).bound(case.output, case.quantities)
    limits = [case.tolerance] + ([] if bound is None else [bound])
    for number in range(rounds):
        reading = case.measure(name, number)
        if all(reading.within(limit) != "unclear" for limit in limits):
            break
    if bound is not None:
        found.stated += 1
        if reading.within(bound) == "no":
            spread = f" +- {reading.sd:.2g}" if reading.sd else ""
            found.broken.append(f"{name}: {reading.error:.4g}{spread}, stated {bound:.4g}")
    return reading


def log_between(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
