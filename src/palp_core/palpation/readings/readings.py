"""Readings with the names of what was felt, how and when: the one form that is analysed."""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

ONLY_SETTING = "(one)"
"""Name of the setting where none is told."""

_LISTED = 8  # rows that a note names


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings, a row each, in the order in which they were taken within a trial.

    A trial is of one class: a trial's name that several classes have is a trial of each, and all of them are
    kept out of training together. :meth:`of` makes readings from names.

    Attributes:
        values: Shape (n, f), finite, any unit per column.
        class_index: Which class each is of, shape (n,).
        setting_index: Which setting it was taken at, shape (n,).
        trial_index: Which trial's name it has, shape (n,).
        columns: Name of each column of values, length f.
        classes: Name of each class.
        settings: Name of each setting.
        trials: Name of each trial.
        notes: What was left out, and why.
    """

    values: Float64Array
    class_index: NDArray[np.int64]
    setting_index: NDArray[np.int64]
    trial_index: NDArray[np.int64]
    columns: tuple[str, ...]
    classes: tuple[str, ...]
    settings: tuple[str, ...]
    trials: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        values: ArrayLike,
        classes: Sequence[Any] | NDArray[Any],
        *,
        settings: Sequence[Any] | NDArray[Any] | None = None,
        trials: Sequence[Any] | NDArray[Any] | None = None,
        columns: Sequence[str] | None = None,
        rows: Sequence[int] | None = None,
    ) -> Readings:
        """Return readings with names; those that are not finite are left out with a note.

        Args:
            values: One number a reading, shape (n,), or several, shape (n, f).
            classes: What was felt, length n; anything with a text.
            settings: How, length n; None: always alike.
            trials: Readings of one trial have one name, length n; None: each is a trial.
            columns: Names of the values' columns; None: numbers.
            rows: What notes call each reading, length n; None: from 0 on.

        Raises:
            PerceptionError: Lengths differ, a name is missing, there are fewer than two classes, no reading
                is left, or all of a column are equal.
        """
        table = np.asarray(values, dtype=np.float64)
        table = table[:, None] if table.ndim == 1 else table
        if table.ndim != 2 or not table.size:
            raise PerceptionError(f"readings have shape {np.shape(values)}, not (n,) or (n, f)")
        names = tuple(columns) if columns is not None else tuple(map(str, range(table.shape[1])))
        count = len(table)
        numbers = range(count) if rows is None else rows
        how = [ONLY_SETTING] * count if settings is None else settings
        when = list(range(count)) if trials is None else trials
        lengths = {"classes": len(classes), "settings": len(how), "trials": len(when), "rows": len(numbers)}
        wrong = [f"{length} {name}" for name, length in lengths.items() if length != count]
        if wrong or len(names) != table.shape[1]:
            raise PerceptionError(
                f"{count} readings of {table.shape[1]} columns, but {', '.join(wrong) or f'names {names}'}"
            )
        for what, given in (("class", classes), ("setting", how), ("trial", when)):
            if unnamed := [number for number, one in zip(numbers, given, strict=True) if _is_no_name(one)]:
                raise PerceptionError(f"row {unnamed[0]} has no {what}; name it, or leave the row out")
        kept: NDArray[np.bool_] = np.asarray(np.isfinite(table).all(axis=1))
        notes = _left_out(table, kept, names, numbers)
        if not kept.any():
            raise PerceptionError("no reading is left: each has a column that is no finite number")
        for name, column in zip(names, table[kept].T, strict=True):
            if np.ptp(column) == 0.0:
                raise PerceptionError(
                    f"all readings of {name} are {column[0]:g}; it tells nothing, leave it out"
                )
        found = [
            _indexed([str(one) for one, keep in zip(of, kept, strict=True) if keep])
            for of in (classes, how, when)
        ]
        if len(found[0][1]) < 2:
            raise PerceptionError(
                f"all readings are of the class '{found[0][1][0]}'; two are the least to tell apart"
            )
        (label, classes_of), (setting, settings_of), (trial, trials_of) = found
        return cls(
            table[kept], label, setting, trial, names, classes_of, settings_of, trials_of, tuple(notes)
        )

    def counts(self, which: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
        """Return how many readings each class has at each setting, of all rows or of some, shape (m, k)."""
        shape = (len(self.classes), len(self.settings))
        cell = self.class_index * shape[1] + self.setting_index
        return np.bincount(cell if which is None else cell[which], minlength=shape[0] * shape[1]).reshape(
            shape
        )

    def dealt(self, repeats: int, *, seed: int = 1) -> Readings:
        """Return the readings dealt at random into made-up trials of ``repeats`` a setting or a few more.

        For readings that were each taken by themselves: a policy then has something to choose from. Every
        reading is in one trial. What stayed in a real trial is dealt over many, and noted.

        Raises:
            PerceptionError: A class has not so many readings at a setting where it was felt.
        """
        rng, counts = np.random.default_rng(seed), self.counts()
        trial, named = np.zeros(len(self.values), dtype=np.int64), 0
        for c, name in enumerate(self.classes):
            least = int(counts[c][counts[c] > 0].min())
            if repeats < 1 or least < repeats:
                raise PerceptionError(
                    f"class '{name}' has {least} readings at a setting; trials of {repeats} cannot be dealt"
                )
            for k in range(len(self.settings)):
                rows = np.flatnonzero((self.class_index == c) & (self.setting_index == k))
                trial[rng.permutation(rows)] = named + np.arange(rows.size) % (least // repeats)
            named += least // repeats
        note = (
            f"{named} trials were made up: readings were dealt at random, {repeats} a setting or a few more; "
            "what stays in a real trial is not in them, so that beliefs look surer than they may be"
        )
        names = tuple(map(str, range(named)))
        return replace(self, trial_index=trial, trials=names, notes=(*self.notes, note))

    def at_settings(self, kept: Sequence[int], note: str) -> Readings:
        """Return the readings taken at some settings, with a note of why the others were left out."""
        order = np.full(len(self.settings), -1)
        order[list(kept)] = range(len(kept))
        rows = order[self.setting_index] >= 0
        return Readings(
            self.values[rows],
            self.class_index[rows],
            order[self.setting_index[rows]],
            self.trial_index[rows],
            self.columns,
            self.classes,
            tuple(self.settings[k] for k in kept),
            self.trials,
            (*self.notes, note),
        )


def _is_no_name(name: Any) -> bool:
    return name is None or name == "" or (isinstance(name, float) and np.isnan(name))


def _left_out(
    table: Float64Array, kept: NDArray[np.bool_], columns: Sequence[str], numbers: Sequence[int]
) -> list[str]:
    gone = np.flatnonzero(~kept)
    if not gone.size:
        return []
    named = ", ".join(str(numbers[row]) for row in gone[:_LISTED].tolist())
    of = [name for name, column in zip(columns, table.T, strict=True) if not np.isfinite(column).all()]
    more = f" and {gone.size - _LISTED} more" if gone.size > _LISTED else ""
    return [
        f"{gone.size} of {len(kept)} readings are left out: no finite number in {', '.join(of)} "
        f"(rows {named}{more})"
    ]


def _indexed(names: Sequence[Hashable]) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the index of each name among the different ones in order: numbers by value, else by letters."""
    different = sorted({str(name) for name in names})
    with contextlib.suppress(ValueError):
        different.sort(key=float)
    place = {name: at for at, name in enumerate(different)}
    return np.array([place[str(name)] for name in names], dtype=np.int64), tuple(different)
