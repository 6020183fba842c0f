"""One session as it was recorded: its palpations, grouped into trials, and what was learnt in training."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from palp_core.errors import PalpError, PerceptionError
from palp_core.perception.primitives import Primitives, fit, quantisation_sd
from palp_core.studies.record import Row, read_rows
from palp_core.units import Float64Array

__all__ = ["Session", "Trial", "mm", "read_session"]

_RESOLUTION_N_M = 1e-3 / 64  # the maker's figure for a Nano17 SI-12-0.12; the floor where none was recorded


def mm(length_m: float) -> str:
    """Return a length as people write it in mm: ``2``, ``2.5``."""
    return f"{length_m * 1e3:g}"


@dataclass(frozen=True)
class Trial:
    """One trial of estimation.

    Attributes:
        probes: Its palpations in order; at least one.
    """

    probes: tuple[Row, ...]

    @property
    def depth_m(self) -> float:
        """True depth."""
        return self.probes[0].depth_m

    @property
    def verdict(self) -> str:
        """``decided``, ``undecided``, or ``continue`` where the record ends within the trial."""
        return self.probes[-1].verdict

    @property
    def right(self) -> bool:
        """Whether the last estimate is the true depth; an undecided trial has an estimate too."""
        estimate_m = self.probes[-1].estimate_m
        return estimate_m is not None and abs(estimate_m - self.depth_m) < 1e-9

    @property
    def confidence(self) -> float:
        """Posterior of the estimate, 0 to 1."""
        return min(max(self.probes[-1].posterior), 1.0)


@dataclass(frozen=True)
class Session:
    """A session's record in memory, without its sweeps.

    Attributes:
        folder: Where it is.
        rows: Every palpation.
        depths_m: Classes, in the order of posterior and gain.
        primitives: The memory primitives; None where training did not reach every cell.
        trials: Trials of estimation that came to a verdict.
        unfinished_count: Trials of estimation without one: the record ends within them.
    """

    folder: Path
    rows: tuple[Row, ...]
    depths_m: tuple[float, ...]
    primitives: Primitives | None
    trials: tuple[Trial, ...]
    unfinished_count: int

    @property
    def training(self) -> list[Row]:
        """The palpations of training."""
        return [row for row in self.rows if row.phase == "training"]

    def class_of(self, depth_m: float) -> int:
        """Return the index of the class nearest to a depth."""
        return int(np.argmin(np.abs(np.array(self.depths_m) - depth_m)))

    def at_depth(self, depth_m: float) -> list[Trial]:
        """Return the trials whose true depth belongs to the class of ``depth_m``."""
        wanted = self.class_of(depth_m)
        return [trial for trial in self.trials if self.class_of(trial.depth_m) == wanted]

    @property
    def tried_m(self) -> list[float]:
        """Depths that have a trial, ascending."""
        return [self.depths_m[i] for i in sorted({self.class_of(trial.depth_m) for trial in self.trials})]

    def expected_depth_m(self, trial: Trial) -> Float64Array:
        """Return the posterior's expected depth after 0, 1, ... probes of a trial, shape (probes + 1,).

        The first is the flat prior's.
        """
        flat = np.full(len(self.depths_m), 1.0 / len(self.depths_m))
        beliefs = np.array([flat, *(probe.posterior for probe in trial.probes)])
        expected: Float64Array = beliefs @ np.array(self.depths_m)
        return expected


def read_session(out: str | Path) -> Session:
    """Read a record, whole or cut short.

    Raises:
        PalpError: There is no record there, or a row's posterior has not one entry per depth.
    """
    folder = Path(out)
    rows = read_rows(folder)
    depths_m = _classes(folder) or tuple(sorted({row.depth_m for row in rows}))
    for row in rows:
        if row.phase == "estimation" and len(row.posterior) != len(depths_m):
            raise PalpError(
                f"{folder / 'trials.csv'}: row {row.row} has a posterior of {len(row.posterior)}, not "
                f"{len(depths_m)} classes; the record is damaged, run the session again"
            )
    every = list(_trials(rows))
    ended = tuple(trial for trial in every if trial.verdict in ("decided", "undecided"))
    return Session(folder, tuple(rows), depths_m, _primitives(folder, rows), ended, len(every) - len(ended))


def _classes(folder: Path) -> tuple[float, ...]:
    """Return the depths that the table's own columns name."""
    with (folder / "trials.csv").open(encoding="utf-8", newline="") as file:
        columns = next(csv.reader(file), [])
    labels = [c.removeprefix("posterior_") for c in columns if c.startswith("posterior_")]
    return tuple(float(label.removesuffix("mm")) / 1e3 for label in labels)


def _trials(rows: Iterable[Row]) -> Iterable[Trial]:
    estimation = (row for row in rows if row.phase == "estimation")
    for _, probes in groupby(estimation, key=lambda row: row.trial):
        yield Trial(tuple(probes))


def _primitives(folder: Path, rows: Sequence[Row]) -> Primitives | None:
    """Return what the session learnt; fitted from its training where it ended before that."""
    path = folder / "primitives.json"
    if path.exists():
        return Primitives.from_json_dict(json.loads(path.read_text(encoding="utf-8")))
    training = [row for row in rows if row.phase == "training"]
    if not training:
        return None
    depths_m, rings_m = sorted({row.depth_m for row in training}), sorted({row.ring_m for row in training})
    try:
        return fit(
            np.array([row.peak_n_m for row in training]),
            [depths_m.index(row.depth_m) for row in training],
            [rings_m.index(row.ring_m) for row in training],
            depths_m=depths_m,
            rings_m=rings_m,
            floor=quantisation_sd(_RESOLUTION_N_M),
        )
    except PerceptionError:
        return None
