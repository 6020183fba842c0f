"""One session as it was recorded: its palpations, grouped into trials, and what was learnt in training."""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import msgspec
import numpy as np

from palp_core.errors import PalpError, PerceptionError, in_words
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.primitives import Primitives, fit_cells, quantisation_sd
from palp_core.palpation.session.audit import TrialKey, left_out
from palp_core.palpation.session.trials_csv import Row, read_rows
from palp_core.units import Float64Array
from palp_core.whole_file import read_whole


def mm(length_m: float) -> str:
    """Return a length as people write it in mm: ``2``, ``2.5``."""
    return f"{length_m * 1e3:g}"


@dataclass(frozen=True)
class RecordedTrial:
    probes: tuple[Row, ...]  # its palpations in order; at least one
    mean_m: float  # mean depth of the last belief, over the depths it is about
    confidence: float  # posterior of the estimate, 0 to 1

    @property
    def depth_m(self) -> float:
        return self.probes[0].depth_m

    @property
    def verdict(self) -> str:
        """``decided``, ``undecided``, ``dropped``, or ``continue`` where the record ends within the trial."""
        return self.probes[-1].verdict

    @property
    def right(self) -> bool:
        """Whether the last estimate is the true depth; an undecided trial has an estimate too."""
        estimate_m = self.probes[-1].estimate_m
        return estimate_m is not None and abs(estimate_m - self.depth_m) < 1e-9


@dataclass(frozen=True)
class RecordedSession:
    """A session's record in memory, without its sweeps."""

    folder: Path
    rows: tuple[Row, ...]
    # classes, in the order of posterior and gain; a belief over a grid counts for those nearest to its depths
    depths_m: tuple[float, ...]
    primitives: Primitives | None  # the memory primitives; None where training did not reach every cell
    trials: tuple[RecordedTrial, ...]  # trials of estimation that came to a verdict
    unfinished_count: int  # trials of estimation without one: the record ends within them
    # trials that ended without one, as the ring stood at an untrained position
    dropped: tuple[RecordedTrial, ...] = ()
    # why trials do not count that were excluded, or are to be done again, by phase and number
    left_out: Mapping[TrialKey, str] = field(default_factory=dict)

    @property
    def left_out_count(self) -> int:
        """How many trials of estimation the decisions leave out."""
        return len(
            {(row.phase, row.trial) for row in self.rows if row.phase == "estimation"} & {*self.left_out}
        )

    @property
    def training(self) -> list[Row]:
        return [row for row in self.rows if row.phase == "training"]

    def class_of(self, depth_m: float) -> int:
        """Return the index of the class nearest to a depth."""
        return int(np.argmin(np.abs(np.array(self.depths_m) - depth_m)))

    def at_depth(self, depth_m: float) -> list[RecordedTrial]:
        """Return the trials whose true depth belongs to the class of ``depth_m``."""
        wanted = self.class_of(depth_m)
        return [trial for trial in self.trials if self.class_of(trial.depth_m) == wanted]

    @property
    def tried_m(self) -> list[float]:
        """Depths that have a trial, ascending."""
        return [self.depths_m[i] for i in sorted({self.class_of(trial.depth_m) for trial in self.trials})]

    def expected_depth_m(self, trial: RecordedTrial) -> Float64Array:
        """Return the posterior's expected depth after 0, 1, ... probes of a trial, shape (probes + 1,).

        The first is the flat prior's.
        """
        flat = np.full(len(self.depths_m), 1.0 / len(self.depths_m))
        beliefs = np.array([flat, *(probe.posterior for probe in trial.probes)])
        expected: Float64Array = beliefs @ np.array(self.depths_m)
        return expected


def read_session(out: str | Path, rows: Sequence[Row] | None = None) -> RecordedSession:
    """Read a record, whole or cut short."""
    folder = Path(out)
    rows = read_rows(folder) if rows is None else rows
    believed_m = believed_depths(folder) or tuple(sorted({row.depth_m for row in rows}))
    for row in rows:
        if row.phase == "estimation" and len(row.posterior) != len(believed_m):
            raise PalpError(
                f"{folder / 'trials.csv'}: row {row.row} has a posterior of {len(row.posterior)}, not "
                f"{len(believed_m)} classes; the record is damaged, run the session again"
            )
    primitives = _primitives(folder, rows)
    taught_m = tuple(sorted(primitives.depths_m.tolist() if primitives is not None else _trained(rows)))
    grid = 1 < len(taught_m) < len(believed_m)
    depths_m = taught_m if grid else believed_m
    counted = [_counted(row, believed_m, depths_m) for row in rows] if grid else rows
    decided = left_out(folder)
    every = [
        trial
        for trial in _trials(rows, counted, believed_m, depths_m)
        if (trial.probes[0].phase, trial.probes[0].trial) not in decided
    ]
    ended = tuple(trial for trial in every if trial.verdict in ("decided", "undecided"))
    dropped = tuple(trial for trial in every if trial.verdict == "dropped")
    unfinished = len(every) - len(ended) - len(dropped)
    return RecordedSession(folder, tuple(counted), depths_m, primitives, ended, unfinished, dropped, decided)


def _trained(rows: Sequence[Row]) -> set[float]:
    return {row.depth_m for row in rows if row.phase == "training"}


def _counted(row: Row, grid_m: Sequence[float], depths_m: Sequence[float]) -> Row:
    """Return a row whose belief over a grid is one over the classes nearest to its depths."""
    if not row.posterior:
        return row
    nearest = np.argmin(np.abs(np.array(grid_m)[:, None] - np.array(depths_m)), axis=1)
    mass, gain = (np.bincount(nearest, weights=w, minlength=len(depths_m)) for w in (row.posterior, row.gain))
    best = depths_m[nearest[int(np.argmax(row.posterior))]]
    return msgspec.structs.replace(row, posterior=mass.tolist(), gain=gain.tolist(), estimate_m=best)


def believed_depths(folder: Path) -> tuple[float, ...]:
    """Return the depths that the table's own columns name, in the order of posterior and gain."""
    with (folder / "trials.csv").open(encoding="utf-8", newline="") as file:
        columns = next(csv.reader(file), [])
    labels = [c.removeprefix("posterior_") for c in columns if c.startswith("posterior_")]
    return tuple(float(label.removesuffix("mm")) / 1e3 for label in labels)


def _trials(
    rows: Sequence[Row], counted: Sequence[Row], believed_m: Sequence[float], depths_m: Sequence[float]
) -> Iterator[RecordedTrial]:
    """Give the trials of estimation, their probes as counted; the mean depth is the belief's own."""
    pairs = (pair for pair in zip(rows, counted, strict=True) if pair[0].phase == "estimation")
    for _, group in groupby(pairs, key=lambda pair: pair[0].trial):
        raw, probes = zip(*group, strict=True)
        believed, last = raw[-1].posterior, probes[-1]
        estimate_m = believed_m[int(np.argmax(believed))] if last.estimate_m is None else last.estimate_m
        stated = last.posterior[int(np.argmin(np.abs(np.array(depths_m) - estimate_m)))]
        yield RecordedTrial(probes, float(np.dot(believed, believed_m)), min(stated, 1.0))


def _primitives(folder: Path, rows: Sequence[Row]) -> Primitives | None:
    """Return what the session learnt; fitted from its training where it ended before that."""
    path = folder / "primitives.json"
    if path.exists():
        try:
            return Primitives.from_json_dict(json.loads(read_whole(path)))
        except (OSError, ValueError, TypeError, RecursionError, PerceptionError) as error:
            raise PalpError(
                f"{path} cannot be read: {in_words(error)}; remove it, and it is fitted again from trials.csv"
            ) from error
    training = [row for row in rows if row.phase == "training"]
    if not training:
        return None
    readings = [(row.depth_m, row.ring_m, row.peak_n_m) for row in training]
    try:
        return fit_cells(readings, quantisation_sd(RESOLUTION_N_M))  # where no floor was recorded
    except PerceptionError:
        return None
