"""What is exported: a session's folder, or a bag of its run, which has EMG, too."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

import palp_core
from palp_core.errors import PalpError
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.export.human_tables import human_recordings, human_tables
from palp_core.palpation.export.tables import (
    ExportTable,
    emg_table,
    iterations_table,
    sweeps_table,
    trials_table,
)
from palp_core.palpation.identification.emg.files import EmgFile
from palp_core.palpation.identification.emg.files_bag import read_bag
from palp_core.palpation.session.audit import left_out
from palp_core.palpation.session.bag_record import is_bag, write_record
from palp_core.palpation.session.human.record import is_human_session, read_human
from palp_core.palpation.session.recorded_session import believed_depths
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.sheet import NONE, SessionSheet
from palp_core.palpation.session.trials_csv import read_rows


@dataclass(frozen=True, eq=False)
class ExportSource:
    """A session ready to be written."""

    path: Path
    # by name: ``trials``, ``iterations``, ``sweeps``, ``emg``; of a session with a person ``human_trials``,
    # ``human_recordings``, ``human_emg``
    tables: dict[str, ExportTable]
    sheet: SessionSheet | None
    run: dict[str, Any]  # which run it is, as plain values
    notes: tuple[str, ...]  # what whoever exports it ought to know

    @property
    def facts(self) -> dict[str, Any]:
        """Sheet and run as plain values, for formats that keep such things."""
        return {"sheet": msgspec.to_builtins(self.sheet), "run": self.run}


def read_source(path: Path) -> ExportSource:
    """Read all tables of a session."""
    if is_human_session(path):
        return _read_human(path)
    notes: list[str] = []
    emg = None
    with contextlib.ExitStack() as stack:
        folder = path
        if is_bag(path):
            folder = stack.enter_context(_record_of(path))
            summary = read_note(folder)
            emg = _emg(path, summary, notes)
        else:
            summary = read_note(path)
            notes.append(
                "a session's folder keeps no EMG; the bag of the run has it: palp session export BAG"
            )
        if summary.exit_code != 0:
            notes.append(f"the session is unfinished ({summary.ended}): what it has is exported")
        sheet = sheet_of(summary)
        subject = sheet.subject if sheet is not None else NONE
        rows = read_rows(folder)
        depths_m = believed_depths(folder)
        tables = (
            trials_table(rows, depths_m, subject, left_out(folder)),
            iterations_table(rows, depths_m, subject),
            sweeps_table(folder, rows),
            emg_table(emg),
        )
    return ExportSource(path, {one.name: one for one in tables}, sheet, _run(summary), tuple(notes))


def _read_human(folder: Path) -> ExportSource:
    """Read all tables of a session with a person."""
    summary = read_note(folder)
    rows = read_human(folder)
    notes = [f"the session is unfinished ({summary.ended}): what it has is exported"]
    tables = human_tables(rows, human_recordings(folder, rows), left_out(folder))
    return ExportSource(
        folder,
        {one.name: one for one in tables},
        sheet_of(summary),
        _run(summary),
        tuple(notes if summary.exit_code != 0 else ()),
    )


@contextlib.contextmanager
def _record_of(bag: Path) -> Iterator[Path]:
    """Give the record that a bag holds, in a folder for the while."""
    with tempfile.TemporaryDirectory(prefix="palp-export-") as folder:
        write_record(bag, Path(folder) / "record")
        yield Path(folder) / "record"


def _emg(bag: Path, summary: RunSummary, notes: list[str]) -> EmgFile | None:
    """Return the EMG of a bag; a run without an amplifier has none."""
    if "EmgBlock" not in {kind for topics in summary.publishes.values() for kind in topics.values()}:
        notes.append("the run has no EMG")
        return None
    try:
        return read_bag(bag)
    except PalpError as error:
        notes.append(f"no EMG: {error}")
        return None


def _run(summary: RunSummary) -> dict[str, Any]:
    return {
        "graph": summary.graph,
        "launch_file": Path(summary.file).name,
        "clock": summary.clock,
        "seed": summary.seed,
        "finished": summary.exit_code == 0,
        "exported_by": f"palp {palp_core.__version__}",
    }
