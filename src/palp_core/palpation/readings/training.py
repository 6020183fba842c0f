"""What is learnt from readings, and that it is never learnt from the trial that is judged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from palp_core.counted import counted
from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.vector_primitives import (
    VectorPrimitives,
    column_floor,
    fit_vectors,
)
from palp_core.palpation.readings.readings import Readings

Covariance = Literal["auto", "full", "diagonal"]

MANY = 25
"""Readings of the poorest cell from which on mean and deviation count as known: normal, not Student's t.

With a full covariance so many a column.
"""
PER_COLUMN = 10
"""Readings a column that the poorest cell must have for a full covariance.

With as many, of two to six columns and classes that overlap, it costs one to three points of accuracy where
the columns are independent, and brings four to six where they are correlated by 0.8. With half as many it
costs two to five.
"""
_FEWEST = 2  # readings of a cell: one has no spread


@dataclass(frozen=True)
class Fold:
    """Trials that are judged together, and what was learnt from all others.

    Attributes:
        judged: Names of trials, as indices.
        primitives: Learnt without them.
    """

    judged: tuple[int, ...]
    primitives: VectorPrimitives


@dataclass(frozen=True)
class Training:
    """How training is done.

    Attributes:
        readings: At the settings that were felt with every class.
        folds: Names of trials that are judged together.
        least: Readings of the poorest cell in the poorest training.
        full: Whether the columns of a cell may be correlated.
        why: Reason for the covariance.
    """

    readings: Readings
    folds: tuple[tuple[int, ...], ...]
    least: int
    full: bool
    why: str

    def learnt(self) -> Iterator[Fold]:
        """Yield each fold with what its training taught.

        Raises:
            PerceptionError: A column of the readings is constant or a function of the others.
        """
        all_of = self.readings
        shape = (len(all_of.classes), len(all_of.settings))
        for judged in self.folds:
            taught = ~np.isin(all_of.trial_index, judged)
            values = all_of.values[taught]
            yield Fold(
                judged,
                fit_vectors(
                    values,
                    all_of.class_index[taught],
                    all_of.setting_index[taught],
                    shape=shape,
                    floor=column_floor(values),
                    full=self.full,
                ),
            )

    def likelihood(self, name: str) -> tuple[str, str]:
        """Return which likelihood a name stands for, ``auto`` too, and why."""
        if name != "auto":
            return name, "as asked"
        many = MANY * (len(self.readings.columns) if self.full else 1)
        if self.least < many:
            return "student_t", f"a cell is learnt from {self.least} readings only, fewer than {many}"
        return "normal", f"every cell is learnt from {self.least} readings or more, at least {many}"


def training(
    readings: Readings, *, fold_count: int = 0, covariance: Covariance = "auto", seed: int = 1
) -> Training:
    """Return how to train for every trial without it.

    Args:
        readings: All of them.
        fold_count: In so many parts the trials are shared out at random, each class evenly; 0: every trial by
            itself.
        covariance: Of the columns of a cell; ``auto``: full where the poorest cell has enough readings.
        seed: Of the shares.

    Raises:
        PerceptionError: No setting was felt with every class, a cell has too few readings to learn from when
            a trial is judged, or there are fewer trials than parts.
    """
    readings = _comparable(readings)
    names = np.unique(readings.trial_index)
    if len(names) < 2 or fold_count == 1 or fold_count > len(names):
        raise PerceptionError(
            f"{len(names)} trials cannot be judged in {fold_count or len(names)} parts: each is judged by "
            "what the others taught; give two trials or more, and 2 parts to as many as there are trials"
        )
    folds = _parts(readings, fold_count or len(names), np.random.default_rng(seed))
    least = _least(readings, folds)
    full, why = _covariance(covariance, least, len(readings.columns))
    return Training(readings, folds, least, full, why)


def _parts(readings: Readings, count: int, rng: np.random.Generator) -> tuple[tuple[int, ...], ...]:
    """Return names of trials shared out at random, each class evenly over the parts."""
    names, first = np.unique(readings.trial_index, return_index=True)
    drawn = rng.permutation(len(names))
    order = names[drawn[np.argsort(readings.class_index[first[drawn]], kind="stable")]]
    return tuple(tuple(sorted(order[part::count].tolist())) for part in range(count))


def _comparable(readings: Readings) -> Readings:
    """Return the readings at settings that were felt with every class."""
    felt = readings.counts() > 0
    kept = np.flatnonzero(felt.all(axis=0)).tolist()
    lacking = [
        f"{readings.settings[k]} ({', '.join(np.array(readings.classes)[~felt[:, k]].tolist())})"
        for k in range(len(readings.settings))
        if k not in kept
    ]
    if not kept:
        raise PerceptionError(
            "no setting was felt with every class, so no reading can be compared; without readings: "
            f"{'; '.join(lacking)}"
        )
    if not lacking:
        return readings
    return readings.at_settings(
        kept, f"settings left out, for a class was never felt there: {'; '.join(lacking)}"
    )


def _least(readings: Readings, folds: tuple[tuple[int, ...], ...]) -> int:
    """Return the readings of the poorest cell in the poorest training.

    Raises:
        PerceptionError: It has fewer than two.
    """
    total, least = readings.counts(), np.iinfo(np.int64).max
    for judged in folds:
        left = total - readings.counts(np.isin(readings.trial_index, judged))
        least = min(least, int(left.min()))
        if least < _FEWEST:
            c, k = (int(i) for i in np.unravel_index(np.argmin(left), left.shape))
            raise PerceptionError(_too_poor(readings, total, judged, c, k, int(left[c, k])))
    return least


def _too_poor(
    readings: Readings, total: NDArray[np.int64], judged: tuple[int, ...], c: int, k: int, left: int
) -> str:
    of = f"class '{readings.classes[c]}' at setting '{readings.settings[k]}'"
    trials = ", ".join(f"'{readings.trials[t]}'" for t in judged[:3]) + (" ..." if len(judged) > 3 else "")
    return (
        f"{of} has {counted(int(total[c, k]), 'reading')}, of which {left} are left to learn from when "
        f"trial {trials} is judged; {_FEWEST} are the least that have a spread. "
        "Give that cell readings in more trials, or leave the class or the setting out"
    )


def _covariance(asked: Covariance, least: int, columns: int) -> tuple[bool, str]:
    enough = PER_COLUMN * columns
    if columns == 1:
        return False, "readings have one column"
    if asked == "full" and least <= columns:
        raise PerceptionError(
            f"a full covariance of {columns} columns needs {columns + 1} readings in every cell, and one has "
            f"{least}; use a diagonal one"
        )
    if asked != "auto":
        return asked == "full", "as asked"
    if least >= enough:
        return True, f"the poorest cell is learnt from {least} readings, at least {PER_COLUMN} a column"
    return False, (
        f"the poorest cell is learnt from {least} readings, fewer than {PER_COLUMN} a column; columns are "
        "taken for independent of each other"
    )
