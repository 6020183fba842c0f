"""Analysis of variance as published, and what to use where it has no value.

Right-or-wrong outcomes break the assumptions of the analysis of variance: a constant outcome gives a p-value
made of rounding noise, cells that are all right or all wrong an infinite F, one value a cell nothing. Such
tables are *not testable*, with the reason. The alternative, permutation within sessions, is here too.
"""

import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

Labels = Sequence[Hashable]

NOT_FINITE = "an outcome is not finite"
_ROUNDING = 1e-12  # of the largest outcome


@dataclass(frozen=True)
class NotTestable:
    """A comparison that has no value, and why."""

    reason: str


@dataclass(frozen=True)
class Effect:
    """One line of a table."""

    name: str  # Factor, or `a:b` for the interaction
    df: float  # Degrees of freedom
    statistic: float  # F
    p: float  # p-value


@dataclass(frozen=True)
class Anova:
    """A table of effects."""

    effects: tuple[Effect, ...]  # First factor, second factor, interaction
    residual_df: float  # Degrees of freedom of the residual
    caution: str  # What a reader must know of its assumptions

    def p(self, name: str) -> float:
        """Return the p-value of an effect."""
        return next(effect.p for effect in self.effects if effect.name == name)


@dataclass(frozen=True)
class PairTest:
    """Two levels of a factor; ``p_bonferroni`` is None where the pair is not testable."""

    first: str
    second: str
    difference: float
    p_bonferroni: float | None
    reason: str = ""


def checked(outcome: Sequence[float] | Float64Array, *labels: Labels) -> Float64Array:
    """Return outcomes as an array, shape (n,)."""
    values = np.asarray(outcome, dtype=np.float64)
    if values.ndim != 1 or values.size == 0 or any(len(one) != values.size for one in labels):
        lengths = ", ".join(str(len(one)) for one in labels)
        raise PerceptionError(
            f"a test needs a list of outcomes and a label of each kind for every trial; outcomes have shape "
            f"{values.shape}, the labels lengths {lengths}"
        )
    return values


def is_constant(values: Float64Array) -> bool:
    """Return whether values differ by no more than rounding: 0.1 + 0.2 and 0.3 are the same outcome."""
    return bool(np.ptp(values) <= _ROUNDING * np.abs(values).max())


def _cells(outcome: Float64Array, *factors: Labels) -> dict[tuple[Hashable, ...], Float64Array]:
    keys = list(zip(*factors, strict=True))
    cells: dict[tuple[Hashable, ...], list[float]] = {}
    for key, value in zip(keys, outcome.tolist(), strict=True):
        cells.setdefault(key, []).append(value)
    return {key: np.array(values) for key, values in cells.items()}


def _refusal(outcome: Float64Array, *factors: Labels) -> str:
    """Return why a table is not testable, or nothing."""
    if not np.isfinite(outcome).all():
        return NOT_FINITE
    if any(len(set(factor)) < 2 for factor in factors):
        return "a factor has only one level"
    cells = _cells(outcome, *factors)
    if len(cells) < np.prod([len(set(factor)) for factor in factors]):
        return "a cell is empty"
    if is_constant(outcome):
        return "the outcome is constant: there is no variance to analyse"
    if min(len(cell) for cell in cells.values()) < 2:
        return "a cell has one value: the interaction and the residual cannot be told apart"
    if all(is_constant(cell) for cell in cells.values()):
        return "every cell is constant (all right or all wrong): there is no residual variance"
    return ""


def two_way(
    outcome: Sequence[float] | Float64Array, first: Labels, second: Labels, *, names: tuple[str, str]
) -> Anova | NotTestable:
    """Return the two-way analysis of variance with interaction, as in the paper (statsmodels, type II)."""
    values = checked(outcome, first, second)
    reason = _refusal(values, first, second)
    if reason:
        return NotTestable(reason)
    import pandas as pd
    import statsmodels.formula.api as formulas  # type: ignore[import-untyped]
    from statsmodels.stats.anova import anova_lm  # type: ignore[import-untyped]

    data = pd.DataFrame({"y": values, "a": [str(x) for x in first], "b": [str(x) for x in second]})
    table = anova_lm(formulas.ols("y ~ C(a) * C(b)", data=data).fit(), typ=2)
    rows = zip(("C(a)", "C(b)", "C(a):C(b)"), (*names, ":".join(names)), strict=True)
    effects = tuple(
        Effect(name, float(table.loc[row, "df"]), float(table.loc[row, "F"]), float(table.loc[row, "PR(>F)"]))
        for row, name in rows
    )
    flat = sum(is_constant(cell) for cell in _cells(values, first, second).values())
    caution = "trials counted as independent; repeated measures and the sessions are ignored"
    if flat:
        caution += f"; {flat} cells are constant, so the variances differ"
    return Anova(effects, float(table.loc["Residual", "df"]), caution)


def bonferroni(outcome: Sequence[float] | Float64Array, group: Labels) -> list[PairTest]:
    """Return all pairs of groups by Welch's t test, p times the number of pairs (at most 1)."""
    cells = _cells(checked(outcome, group), group)
    pairs = list(itertools.combinations(sorted(cells, key=lambda key: str(key[0])), 2))
    found = []
    for one, other in pairs:
        a, b = cells[one], cells[other]
        gap = float(a.mean() - b.mean())
        if not np.isfinite(gap):
            found.append(PairTest(str(one[0]), str(other[0]), gap, None, NOT_FINITE))
            continue
        if min(len(a), len(b)) < 2 or is_constant(a) or is_constant(b):
            found.append(PairTest(str(one[0]), str(other[0]), gap, None, "a group is constant or one value"))
            continue
        p = float(scipy.stats.ttest_ind(a, b, equal_var=False).pvalue)
        found.append(PairTest(str(one[0]), str(other[0]), gap, min(1.0, p * len(pairs))))
    return found


def permutation(
    outcome: Sequence[float] | Float64Array,
    group: Labels,
    session: Labels,
    rng: np.random.Generator,
    *,
    shuffles: int = 2000,
) -> float | NotTestable:
    """Return the p-value of equal group means when labels are exchanged within sessions.

    Statistic: sum over groups of count times squared deviation of the group's mean.
    """
    values = checked(outcome, group, session)
    if shuffles < 1:
        raise PerceptionError(f"shuffles is {shuffles}; a permutation test needs at least one")
    if not np.isfinite(values).all():
        return NotTestable(NOT_FINITE)
    if is_constant(values):
        return NotTestable("the outcome is constant: every exchange is the same")
    labels = np.unique([str(g) for g in group], return_inverse=True)[1]
    blocks = np.unique([str(s) for s in session], return_inverse=True)[1]
    if all(len(np.unique(labels[blocks == b])) < 2 for b in np.unique(blocks)):
        return NotTestable("a session has one group only: there is nothing to exchange")
    order = np.argsort(blocks, kind="stable")
    values, labels, blocks = values[order], labels[order], blocks[order]
    count = np.bincount(labels)

    def spread(these: Float64Array) -> float:
        means = np.bincount(labels, weights=these) / count
        return float(count @ (means - these.mean()) ** 2)

    seen, hits = spread(values), 1
    for _ in range(shuffles):
        mixed = values[np.lexsort((rng.random(len(values)), blocks))]
        hits += spread(mixed) >= seen * (1.0 - 1e-12)
    return hits / (shuffles + 1)
