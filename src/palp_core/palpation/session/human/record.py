"""The record of a session with a person, written trial by trial.

::

    OUT/human_trials.csv                     one row per trial, a spoilt one too
    OUT/emg/S01/rest.npz, mvc.npz            both muscles at rest and in the MVC that counts
    OUT/emg/S01/training/01_2mm.npz          the EMG of a trial, raw
    OUT/emg/S01/estimation/01_2mm.npz        likewise; a second attempt has 01b
    OUT/emg_discarded/S01/...                contractions and trials that were done again
    OUT/interrupted/1/...                    table and EMG of the trial that was under way at an interruption
    OUT/identity.json                        who it was, in codes; readable by its owner only

``palp emg fit-policy OUT`` learns the subject's chains from what counts.
"""

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.reporting.table import csv_text
from palp_core.palpation.session.audit import left_out
from palp_core.palpation.session.human.plan import Phase
from palp_core.palpation.session.session_folder import cannot_write
from palp_core.palpation.session.session_table import SessionTable, TableForm, read_table
from palp_core.units import Float64Array
from palp_core.whole_file import whole_file, write_json

HUMAN_TABLE = "human_trials.csv"
IDENTITY = "identity.json"
RESULT = "human.json"
EMG = "emg"
DISCARDED = "emg_discarded"


def is_human_session(folder: Path) -> bool:
    """Return whether a folder holds a session of a person's own fingers."""
    return (folder / HUMAN_TABLE).exists()


class HumanRow(msgspec.Struct, frozen=True, kw_only=True):
    """One trial. What was not asked, or is sealed, is None.

    ``trial``: its number in its phase, from 1; ``attempt``: of the trial; ``ended_by``: ``subject``,
    ``limit``, or ``repeat`` where it was spoilt and is done again. ``palpation_s`` is from begin to end of
    the palpation, ``answer_s`` from the question to the answer. ``answer_mm`` is the answer,
    ``estimate_m`` the nearest of the phantoms' depths. ``emg``: the file of its EMG. ``source`` and
    ``answered_by``: whose it was; :func:`is_of_a_person` asks them.
    """

    row: int
    subject: str
    phase: Phase
    trial: int
    attempt: int
    phantom: str
    depth_m: float | None
    told: bool
    palpation_s: float
    ended_by: str
    answer_s: float | None
    answer_mm: float | None
    estimate_m: float | None
    emg: str
    lost_count: int
    clipped_count: int
    source: str
    answered_by: str
    order: str
    subject_number: int
    seed: int
    end_ns: int

    def __post_init__(self) -> None:
        numbers = (self.depth_m, self.palpation_s, self.answer_s, self.answer_mm, self.estimate_m)
        if not all(math.isfinite(number) for number in numbers if number is not None):
            raise ValueError("a number is not finite")


_FORM = TableForm(HumanRow)


def is_of_a_person(row: HumanRow) -> bool:
    """Return whether a row is of a person: muscles and answers both."""
    return row.source == "person" and row.answered_by not in ("", "script")


def emg_name(phase: str, number: int, attempt: int, phantom: str, depth_m: float | None) -> str:
    """Return the name of a trial's EMG below the subject's folder; a sealed depth is the phantom's code.

    >>> emg_name("training", 3, 1, "B", 0.004), emg_name("training", 3, 2, "K7", None)
    ('training/03_4mm.npz', 'training/03b_K7.npz')
    """
    again = "" if attempt == 1 else chr(ord("a") + min(attempt - 1, 25))
    what = phantom if depth_m is None else f"{round(depth_m * 1e3, 6):g}mm"
    return f"{phase}/{number:02d}{again}_{what}.npz"


class HumanWriter(SessionTable):
    def __init__(self, out: str) -> None:
        super().__init__(out, HUMAN_TABLE, "trial")

    def start(self) -> None:
        refuse_human(self.folder)
        with self._taken(made=True):
            self._begin(_FORM.columns())

    def go_on(self, row_count: int) -> None:
        """Go on with what an interrupted session has left, as it was after so many rows.

        What came later is of the trial that was under way, which is done again: it is set aside.
        """
        with self._taken():
            rows = read_human(self.folder)
            self._require(rows, row_count)
            loose = emg_without_row(self.folder, rows[:row_count], (EMG, DISCARDED))
            if loose or len(rows) > row_count:
                place = self._set_aside(row_count, len(rows))
                for path in loose:
                    target = place / path.relative_to(self.folder)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    path.rename(target)
            self._cut(row_count)

    def identity(self, subject: str, consent: str, **more: Any) -> None:
        try:
            write_json(self.folder / IDENTITY, {"subject": subject, "consent": consent, **more}, mode=0o600)
        except OSError as error:
            raise cannot_write(self.folder, error) from error

    def append(self, row: HumanRow) -> None:
        """Add a trial; its EMG was written before."""
        try:
            self._append(_FORM.cells(row))
        except OSError as error:
            raise self._failure(error, f"{row.phase} trial {row.trial}", "all trials before") from error

    def emg(
        self, subject: str, name: str, samples_v: Float64Array, rate_hz: float, *, discarded: bool = False
    ) -> str:
        """Write raw EMG, shape (2, n), flexor first; return its path in the folder."""
        path = self.folder / (DISCARDED if discarded else EMG) / subject / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as file:
                np.savez_compressed(file, fds_v=samples_v[0], edc_v=samples_v[1], rate_hz=np.array(rate_hz))
        except OSError as error:
            raise self._failure(error, str(path.name), "all trials before") from error
        return str(path.relative_to(self.folder))


def refuse_human(folder: Path, ways_on: str = "give this one another folder, out:=NAME") -> None:
    """Refuse a folder that holds a session with a person, or another."""
    for name in (HUMAN_TABLE, "trials.csv"):
        if (folder / name).exists():
            raise PalpError(
                f"'{folder}' holds a session already ({name}), and what a person did is never overwritten: "
                f"{ways_on}"
            )


def human_table_text(rows: Sequence[HumanRow]) -> str:
    """Return a whole table, as :class:`HumanWriter` writes it row by row."""
    return csv_text(_FORM.columns(), *map(_FORM.cells, rows))


def read_human(out: str | Path, *, whole: bool = False) -> list[HumanRow]:
    return read_table(Path(out) / HUMAN_TABLE, f"no session with a person in '{out}'", _FORM, whole=whole)


def emg_without_row(out: Path, rows: Sequence[HumanRow], places: Collection[str] = (EMG,)) -> list[Path]:
    """Return the EMG of trials that none of the rows has: of a lost row, or of a trial that was not over."""
    kept = {row.emg for row in rows}
    found = (path for name in places for path in sorted(out.glob(f"{name}/*/*/*.npz")))
    return [path for path in found if str(path.relative_to(out)) not in kept]


def emg_that_does_not_count(out: Path) -> set[Path]:
    """Return the files of EMG whose trials were excluded, or are to be done again."""
    decided = left_out(out)
    return {out / row.emg for row in read_human(out) if row.emg and (row.phase, row.trial) in decided}


def emg_depths(out: Path) -> dict[Path, float | None]:
    """Return the depth of each trial's EMG by its file, m; None where it is sealed."""
    return {out / row.emg: row.depth_m for row in read_human(out) if row.emg}
