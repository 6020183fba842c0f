"""The report of a session: ``result.json``, ``report.html`` and ``charts/``, however its run ended.

A launch file names it: ``report: palp_core.palpation.session.report:session``. What draws is imported when it
is needed: the launcher asks for this module before the run begins.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palp_core.errors import PalpError
from palp_core.palpation.session import run_note
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.session_folder import RESULT, SWEEPS, TABLE
from palp_core.palpation.session.sheet.of_run import (
    asked_sheet,
    refuse_own_sheet,
    sheet_of,
    texts_to_keep,
    write_copy,
)

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary
    from palp_core.palpation.reporting.charts import Chart
    from palp_core.palpation.session.recorded_session import RecordedSession


class SessionReport:
    """What a launch file's ``report`` does before, at the beginning and after the end of a run."""

    def prepare(self, summary: RunSummary) -> None:
        """Refuse a run whose session would go where one is already.

        Raises:
            PalpError: It would, the run names no folder, or the session's sheet is missing or wrong.
        """
        refuse_own_sheet(run_note.out_of(summary))
        run_note.refuse_run(summary)
        asked_sheet(summary)

    def attach(self, summary: RunSummary) -> dict[str, str]:
        """Return what is kept with all that is recorded of the run, by name: the session's sheet."""
        return texts_to_keep(asked_sheet(summary))

    def advise(self, summary: RunSummary) -> list[str]:
        """Return in words what of the parameters no method vouches for."""
        from palp_core.palpation.session.methods.advice import advice

        return advice(summary)

    def begin(self, summary: RunSummary) -> None:
        """Note which run the session is of.

        Raises:
            PalpError: The folder cannot be written.
        """
        run_note.note_begin(summary)

    def complete(self, folder: Path) -> bool:
        """Tell whether a folder holds a session that came to its end; one that lacks its report gets it."""
        try:
            summary = run_note.read_note(folder)
        except PalpError:
            return False
        if summary.exit_code == 0 and not (folder / RESULT).exists():
            write(folder, summary)
        return summary.exit_code == 0

    def pool(self, folder: Path) -> str:
        """Write what the sessions below a folder say together, as a page and tables; return it in words.

        Raises:
            PalpError: There is none, or it cannot be written.
        """
        from palp_core.palpation.session.many.overview import find_sessions
        from palp_core.palpation.session.many.page import pooled_words, write_pooled
        from palp_core.palpation.session.many.pooled import pool

        entries = find_sessions(folder)
        record = pool(entries)
        page = write_pooled(record, entries, folder, folder)
        return "\n".join([*pooled_words(record), f"Written: {page}"])

    def __call__(self, summary: RunSummary) -> str:
        """Write the result, the charts and the page beside the record that a run has just left.

        Returns:
            The result in words, what is kept, and where.

        Raises:
            PalpError: The run names no folder, there is no record in it, or it cannot be written.
        """
        folder = run_note.out_of(summary)
        try:
            if not run_note.note_end(summary):
                return f"Nothing is kept: the session in '{folder}' had not begun."
        except OSError as error:
            raise _cannot_report(folder, error) from error
        return write(folder, summary)


session = SessionReport()


def write(folder: Path, summary: RunSummary) -> str:
    """Write the result, the charts and the page of the session in a folder.

    Args:
        folder: Where the record is now.
        summary: How its run went.

    Returns:
        The result in words, what is kept, and where.

    Raises:
        PalpError: There is no record, or the report cannot be written.
    """
    from palp_core.palpation.session.decided.blind import is_blinded, opened_run
    from palp_core.palpation.session.recorded_session import read_session
    from palp_core.palpation.session.trials_csv import read_rows

    rows = read_rows(folder) if (folder / TABLE).exists() else None
    if rows is not None and is_blinded(rows):
        try:
            write_copy(summary, folder)
        except OSError as error:
            raise _cannot_report(folder, error) from error
        return (
            f"A blinded session: no report before `palp session unseal {folder}`.\n"
            f"Kept: {len(rows)} palpations (trials.csv with codes for depths, sweeps/) in {folder}"
        )
    if rows == [] and summary.exit_code != 0 and not any(folder.glob(f"{SWEEPS}/*.npz")):
        return f"Nothing is kept: '{folder}' holds no palpation."
    summary = opened_run(summary, folder)
    found = read_session(folder, rows)
    if not found.rows and (orphans := sum(1 for _ in folder.glob(f"{SWEEPS}/*.npz"))):
        raise PalpError(
            f"'{folder / TABLE}' has no row, and {folder / SWEEPS} holds {orphans} sweeps: the table was "
            "emptied; restore it, and `palp report` makes the report"
        )
    try:
        write_copy(summary, folder)
        said = _write(found, summary)
    except OSError as error:
        raise _cannot_report(folder, error) from error
    page = f". Report: {folder / 'report.html'}" if (folder / "report.html").exists() else ""
    return (
        f"{said}\nKept: {len(found.rows)} palpations (trials.csv, sweeps/) and result.json in {folder}{page}"
    )


def _cannot_report(folder: Path, error: OSError) -> PalpError:
    return PalpError(
        f"the report of '{folder}' cannot be written: {error.strerror or error}; "
        f"the record is kept there, and `palp report {folder}` makes the report of it"
    )


def _write(found: RecordedSession, summary: RunSummary) -> str:
    from palp_core.palpation.reporting.html_page import picture
    from palp_core.palpation.session.plan_repeatability import is_repeatability
    from palp_core.palpation.session.report_page import headline, write_report
    from palp_core.palpation.session.result_json import build, unfinished_words, write_result

    result = build(found, summary)
    write_result(result, found.folder)
    if is_repeatability([row.phase for row in found.rows]):
        return _repeatability(found, summary, unfinished_words(result))
    pictures = [picture(one, found.folder / "charts") for one in _charts(found, summary, result)]
    page = found.folder / "report.html"
    sheet = sheet_of(summary)
    write_report(page, result, pictures, trials=found.trials, args=summary.args, sheet=sheet)
    return headline(result)


def _repeatability(found: RecordedSession, summary: RunSummary, unfinished: str) -> str:
    """Write the noise file and the page of the plan ``repeatability``."""
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.session.recorded_sweeps import read_sweeps
    from palp_core.palpation.session.repeatability import (
        measure_repeatability,
        repeatability_headline,
        write_repeatability,
    )

    path = roles_of(summary).params("phantom").get("scene", "")
    try:
        measured = measure_repeatability(read_sweeps(found.folder), scene=read_scene(path) if path else None)
    except PalpError as error:
        if unfinished:  # too early to say anything
            return f"{unfinished.capitalize()}; no page: {error}"
        raise
    write_repeatability(measured, found.folder, unfinished)
    said = repeatability_headline(measured)
    return f"{unfinished.capitalize()}. {said}" if unfinished else said


def _charts(found: RecordedSession, summary: RunSummary, result: dict[str, Any]) -> Iterator[Chart]:
    """Yield the charts that the record has numbers for, in the order of the page."""
    from palp_core.palpation.session.charts.estimation import (
        accuracy_chart,
        belief_chart,
        calibration_chart,
        rings_chart,
    )
    from palp_core.palpation.session.charts.steps import steps_chart
    from palp_core.palpation.session.charts.training import primitives_chart, sweeps_chart

    roles = roles_of(summary)
    sweeps = {
        "estimator": _as_read(summary, roles.params("estimator")),
        "from_m": roles.params("experiment").get("from_m"),
        "speed_m_s": roles.params("stage").get("sweep_speed_m_s", 0.020),
    }
    for chart in (
        accuracy_chart(found),
        _drawing(found, summary, result),
        steps_chart(found, **sweeps),
        belief_chart(found),
        calibration_chart(found),
        rings_chart(found),
        primitives_chart(found),
        sweeps_chart(found, **sweeps),
    ):
        if chart is not None:
            yield chart


def _drawing(found: RecordedSession, summary: RunSummary, result: dict[str, Any]) -> Chart | None:
    """Return the drawing of what was simulated; None of a rig with devices, whose sizes nobody told."""
    from palp_core.palpation.session.charts.rig import rig_chart

    if result["mechanics"] is None or not found.rows:
        return None
    return rig_chart(
        result["mechanics"]["scene"],
        rings_m=sorted({row.ring_m for row in found.rows}),
        indentation_m=_indentation_m(summary),
    )


def _indentation_m(summary: RunSummary) -> float:
    """Return how deep the tip was pressed, as the phantom told; of older runs, as was asked."""
    scenes = [json.loads(one.use.scene) for one in summary.methods if one.use.task == "contact"]
    asked_mm = roles_of(summary).params("phantom").get("indentation_mm", 4.0)
    told = (float(scene["indentation_m"]) for scene in scenes if "indentation_m" in scene)
    return next(told, asked_mm * 1e-3)


def _as_read(summary: RunSummary, estimator: dict[str, Any]) -> dict[str, Any]:
    """Return the estimator's parameters with the smoother that the register chose for it."""
    chosen = [one.use.name for one in summary.methods if one.use.task == "denoise" and not one.use.asked]
    return estimator | {"denoise": chosen[0]} if chosen else estimator
