"""The report of a session with a person: ``human.json`` and ``human.html``, however its run ended.

A launch file names it: ``report: palp_core.palpation.session.human.report:session``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.session import run_note
from palp_core.palpation.session.human.blinding import draw_key, refuse_other_key
from palp_core.palpation.session.human.record import HUMAN_TABLE, is_human_session, read_human, refuse_human
from palp_core.palpation.session.human.sheet import asked_sheet
from palp_core.palpation.session.session_folder import RUN, cannot_write
from palp_core.palpation.session.sheet.of_run import (
    refuse_own_sheet,
    sheet_lines,
    sheet_of,
    texts_to_keep,
    write_copy,
)
from palp_core.palpation.session.sheet.sheet import SessionSheet
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

RESULT = "human.json"
PAGE = "human.html"


class HumanReport:
    """What ``launch/human.yaml`` does before, at the beginning and after the end of a run."""

    def prepare(self, summary: RunSummary) -> None:
        """Refuse a run whose session would go where one is already."""
        folder = run_note.out_of(summary)
        if summary.resumed_count:
            run_note.refuse_resuming(folder, HUMAN_TABLE)
            refuse_other_key(summary, folder)
            return
        refuse_own_sheet(folder)
        others = "give this one another folder, out:=NAME"
        refuse_human(folder, run_note.ways_on(folder, others, _progress_words))
        asked_sheet(summary)

    def attach(self, summary: RunSummary) -> dict[str, str]:
        """Return what is kept with all that is recorded of the run, by name: sheet, and digest of a key."""
        return texts_to_keep(asked_sheet(summary)) | draw_key(summary)

    def begin(self, summary: RunSummary) -> None:
        """Note which run the session is of."""
        folder = run_note.out_of(summary)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_json(folder / RUN, summary)
        except OSError as error:
            raise cannot_write(folder, error) from error

    def __call__(self, summary: RunSummary) -> str:
        """Write what the session tells beside its record; return it in words."""
        folder = run_note.out_of(summary)
        try:
            write_json(folder / RUN, summary)
            write_copy(summary, folder)
            if not is_human_session(folder) or not read_human(folder):
                return f"No trial was made in '{folder}': begin again in another folder, out:=NAME."
            return write_human([folder], folder, sheet_of(summary))
        except OSError as error:
            raise PalpError(
                f"the report of '{folder}' cannot be written: {error.strerror or error}"
            ) from error


session = HumanReport()


def _progress_words(folder: Path) -> str:
    return counted(len(read_human(folder)), "trial")


def write_human(
    folders: list[Path], out: Path, sheet: SessionSheet | None = None, *, charts: bool = False
) -> str:
    """Write what one session or several tell into a folder; return it in words."""
    from palp_core.palpation.reporting.html_page import picture, write_page
    from palp_core.palpation.session.human.analysis import analyse, gather
    from palp_core.palpation.session.human.charts import human_charts

    trials = gather(folders)
    told = {"session": msgspec.to_builtins(sheet)} if sheet is not None else {}
    found = told | analyse(trials)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / RESULT, found)
    pictures = [picture(one, out / "charts" if charts else None) for one in human_charts(trials, found)]
    lines = sheet_lines(sheet) if sheet is not None else []
    write_page(out / PAGE, "human.html", result=found, rows=trials.rows, pictures=pictures, sheet=lines)
    return (
        f"{headline(found)}\nKept: {counted(len(trials.rows), 'trial')} ({HUMAN_TABLE}, emg/). "
        f"Report: {out / PAGE}"
    )


def headline(found: dict[str, object]) -> str:
    """Return what an analysis tells, in a sentence."""
    trials: dict[str, int] = found["trials"]  # type: ignore[assignment]
    done = f"{counted(trials['training'], 'trial')} of training, {trials['estimation']} of estimation"
    accuracy: dict[str, float] | None = found["accuracy"]  # type: ignore[assignment]
    if accuracy is None:
        return f"{done}; {found['note']}."
    return (
        f"{done}: right in {accuracy['right']} of {accuracy['of']}, {accuracy['share']:.0%} "
        f"({accuracy['low']:.0%} to {accuracy['high']:.0%})."
    )
