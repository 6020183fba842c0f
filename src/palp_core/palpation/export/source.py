"""What is exported: a session's folder, or a bag of its run, which has EMG, too."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

import palp_core
from palp_core.errors import PalpError
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.export.human_tables import human_tables
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
    path: Path
    tables: dict[str, ExportTable]
    sheet: SessionSheet | None
    run: dict[str, Any]  # which run it is, as plain values
    notes: tuple[str, ...]  # for who exports it

    @property
    def facts(self) -> dict[str, Any]:
        """Sheet and run as plain values, for formats that keep such things."""
        return {"sheet": msgspec.to_builtins(self.sheet), "run": self.run}


def read_source(path: Path) -> ExportSource:
    notes: list[str] = []
    with tempfile.TemporaryDirectory(prefix="palp-export-") as made:
        folder, emg = path, None
        if is_bag(path):
            folder = Path(made) / "record"
            write_record(path, folder)
            emg = _emg(path, read_note(folder), notes)
        summary = read_note(folder)
        sheet, excluded = sheet_of(summary), left_out(folder)
        if is_human_session(folder):
            tables = human_tables(folder, read_human(folder), excluded)
        else:
            if folder is path:
                notes.append(
                    "a session's folder keeps no EMG; the bag of the run has it: palp session export BAG"
                )
            subject = sheet.subject if sheet is not None else NONE
            rows, depths_m = read_rows(folder), believed_depths(folder)
            tables = (
                trials_table(rows, depths_m, subject, excluded),
                iterations_table(rows, depths_m, subject),
                sweeps_table(folder, rows),
                emg_table(emg),
            )
    if summary.exit_code != 0:
        notes.append(f"the session is unfinished ({summary.ended}): what it has is exported")
    run = {
        "graph": summary.graph,
        "launch_file": Path(summary.file).name,
        "clock": summary.clock,
        "seed": summary.seed,
        "finished": summary.exit_code == 0,
        "exported_by": f"palp {palp_core.__version__}",
    }
    return ExportSource(path, {one.name: one for one in tables}, sheet, run, tuple(notes))


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
