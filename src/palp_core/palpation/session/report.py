"""The report of a session: ``result.json`` and ``report.html``, however its run ended.

A launch file names it: ``report: palp_core.palpation.session.report:session``. What draws is imported when it
is needed: the launcher asks for this module before the run begins.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.session import run_note
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.session_folder import SWEEPS, TABLE
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
        """Refuse a run whose session would go where one is already."""
        refuse_own_sheet(run_note.out_of(summary))
        run_note.refuse_run(summary)
        asked_sheet(summary)

    def attach(self, summary: RunSummary) -> dict[str, str]:
        """Return what is kept with all that is recorded of the run, by name: the session's sheet."""
        return texts_to_keep(asked_sheet(summary))

    def advise(self, summary: RunSummary) -> list[str]:
        """Return which parameters no method has a bound for, and what to do."""
        from palp_core.palpation.session.methods.advice import advice

        return advice(summary)

    def begin(self, summary: RunSummary) -> None:
        run_note.note_begin(summary)

    def __call__(self, summary: RunSummary) -> str:
        """Write the result and the page next to the record that a run has just left."""
        folder = run_note.out_of(summary)
        try:
            if not run_note.note_end(summary):
                return f"Nothing is kept: the session in '{folder}' had not begun."
        except OSError as error:
            raise _cannot_report(folder, error) from error
        return write(folder, summary, charts=False)


session = SessionReport()


def write(folder: Path, summary: RunSummary, *, charts: bool = True, files: bool = False) -> str:
    """Write the result and the page of the session in a folder.

    ``charts``: the page has all charts, which take two seconds to draw. ``files``: each is kept as PNG, SVG
    and CSV, too. Return the result as a sentence, what is kept, and where.
    """
    from palp_core.palpation.session.recorded_session import read_session
    from palp_core.palpation.session.trials_csv import read_rows

    rows = read_rows(folder) if (folder / TABLE).exists() else None
    if rows == [] and summary.exit_code != 0 and not any(folder.glob(f"{SWEEPS}/*.npz")):
        return f"Nothing is kept: '{folder}' holds no palpation."
    found = read_session(folder, rows)
    if not found.rows and (orphans := sum(1 for _ in folder.glob(f"{SWEEPS}/*.npz"))):
        raise PalpError(
            f"'{folder / TABLE}' has no row, and {folder / SWEEPS} holds "
            f"{counted(orphans, 'sweep')}: the table was "
            "emptied; restore it, and `palp session report` makes the report"
        )
    try:
        write_copy(summary, folder)
        summary_line = _write(found, summary, charts=charts, files=files)
    except OSError as error:
        raise _cannot_report(folder, error) from error
    page = f". Report: {folder / 'report.html'}" if (folder / "report.html").exists() else ""
    return (
        f"{summary_line}\nKept: {counted(len(found.rows), 'palpation')} (trials.csv, sweeps/) and "
        f"result.json in {folder}{page}"
    )


def _cannot_report(folder: Path, error: OSError) -> PalpError:
    return PalpError(
        f"the report of '{folder}' cannot be written: {error.strerror or error}; "
        f"the record is kept there, and `palp session report {folder}` makes the report of it"
    )


def _write(found: RecordedSession, summary: RunSummary, *, charts: bool, files: bool) -> str:
    from palp_core.palpation.reporting.html_page import picture
    from palp_core.palpation.session.plan_repeatability import is_repeatability
    from palp_core.palpation.session.report_page import headline, write_report
    from palp_core.palpation.session.result import build, write_result

    result = build(found, summary)
    write_result(result, found.folder)
    if is_repeatability([row.phase for row in found.rows]):
        return _repeatability(found, summary, result.unfinished_words())
    folder = found.folder / "charts" if files else None
    pictures = [picture(chart, folder) for chart in charts_of(found, summary)] if charts else []
    page = found.folder / "report.html"
    sheet = sheet_of(summary)
    write_report(page, result, pictures, trials=found.trials, given=summary.given, sheet=sheet)
    return headline(result)


def charts_of(found: RecordedSession, summary: RunSummary) -> list[Chart]:
    """Return the charts that the record has numbers for, in the order of the page."""
    from palp_core.palpation.session.charts.estimation import belief_chart, calibration_chart, rings_chart
    from palp_core.palpation.session.charts.steps import steps_chart
    from palp_core.palpation.session.charts.training import primitives_chart, sweeps_chart

    roles = roles_of(summary)
    chosen = {one.use.task: one.use.name for one in summary.methods if one.use.task == "denoise"}
    sweeps = {
        "estimator": roles.params("estimator") | chosen,
        "from_m": roles.params("experiment").get("from_m"),
        "speed_m_s": roles.params("stage").get("sweep_speed_m_s", 0.020),
    }
    charts = (
        steps_chart(found, **sweeps),
        belief_chart(found),
        calibration_chart(found),
        rings_chart(found),
        primitives_chart(found),
        sweeps_chart(found, **sweeps),
    )
    return [chart for chart in charts if chart is not None]


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
    headline = repeatability_headline(measured)
    return f"{unfinished.capitalize()}. {headline}" if unfinished else headline
