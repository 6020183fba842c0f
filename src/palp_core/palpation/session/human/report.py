"""The report of a session with a person: ``human.json`` and ``human.html``, however its run ended.

A launch file names it: ``report: palp_core.palpation.session.human.report:session``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.session import run_note
from palp_core.palpation.session.human.blinding import draw_key, refuse_other_key
from palp_core.palpation.session.human.record import (
    HUMAN_TABLE,
    RESULT,
    is_human_session,
    read_human,
    refuse_human,
)
from palp_core.palpation.session.session_folder import RUN, cannot_write
from palp_core.palpation.session.sheet.of_run import (
    asked_human_sheet,
    refuse_own_sheet,
    sheet_lines,
    sheet_of,
    texts_to_keep,
    write_copy,
)
from palp_core.palpation.session.sheet.sheet import SessionSheet
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from palp_core.graph.launch.summary import RunSummary
    from palp_core.palpation.reporting.charts import Chart

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
        ways_on = run_note.ways_on(folder, others, lambda it: counted(len(read_human(it)), "trial"))
        refuse_human(folder, ways_on)
        asked_human_sheet(summary)

    def attach(self, summary: RunSummary) -> dict[str, str]:
        """Return what is kept with all that is recorded of the run, by name: sheet, and digest of a key."""
        return texts_to_keep(asked_human_sheet(summary)) | draw_key(summary)

    def begin(self, summary: RunSummary) -> None:
        folder = run_note.out_of(summary)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_json(folder / RUN, summary)
        except OSError as error:
            raise cannot_write(folder, error) from error

    def __call__(self, summary: RunSummary) -> str:
        """Write the report next to the record; return its summary."""
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


def write_human(
    folders: list[Path], out: Path, sheet: SessionSheet | None = None, *, charts: bool = False
) -> str:
    """Write the result and the page of sessions into a folder; return its summary.

    ``charts``: the chart is kept as PNG, SVG and CSV, too, in ``charts/``.
    """
    from palp_core.palpation.reporting.html_page import picture, write_page
    from palp_core.palpation.session.human.analysis import analyse, gather

    trials = gather(folders)
    found = ({"session": msgspec.to_builtins(sheet)} if sheet is not None else {}) | analyse(trials)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / RESULT, found)
    write_page(
        out / PAGE,
        "human.html",
        result=found,
        rows=trials.rows,
        picture=picture(_chart(found), out / "charts" if charts else None) if found["accuracy"] else None,
        sheet=sheet_lines(sheet) if sheet is not None else [],
    )
    return (
        f"{headline(found)}\nKept: {counted(len(trials.rows), 'trial')} ({HUMAN_TABLE}, emg/). "
        f"Report: {out / PAGE}"
    )


def headline(found: dict[str, Any]) -> str:
    trials, accuracy = found["trials"], found["accuracy"]
    done = f"{counted(trials['training'], 'trial')} of training, {trials['estimation']} of estimation"
    if accuracy is None:
        return f"{done}; {found['note']}."
    return (
        f"{done}: right in {accuracy['right']} of {accuracy['of']}, {accuracy['share']:.0%} "
        f"({accuracy['low']:.0%} to {accuracy['high']:.0%})."
    )


def _chart(found: dict[str, Any]) -> Chart:
    """Return right answers over the trials of a depth, and in all, as in Figure 4 of the paper."""
    from palp_core.palpation.reporting.charts import INK, Chart, depth_style, in_percent, legend, tidy

    whole = found["by_depth"]
    rows = [
        (mm, number, one["share"], one["low"], one["high"], one["of"])
        for mm, numbers in found["by_trial"].items()
        for number, one in numbers.items()
        if one is not None
    ]

    def draw(figure: Figure) -> None:
        over, axes = figure.subplots(1, 2, sharey=True)
        for i, (mm, one) in enumerate(whole.items()):
            points = [(int(row[1]), row[2]) for row in rows if row[0] == mm]
            over.plot(*zip(*points, strict=True), **depth_style(i), label=f"{mm} mm")
            error = [[one["share"] - one["low"]], [one["high"] - one["share"]]]
            colour = depth_style(i)["color"]
            axes.bar([f"{mm} mm"], [one["share"]], color=colour, width=0.6, yerr=error, capsize=3)
        for panel in (over, axes):
            panel.axhline(1.0 / len(whole), color=INK, linestyle=":", linewidth=1.0)
            panel.set_ylim(0, 1)
            in_percent(panel.yaxis)
        legend(figure, handles=over.get_lines()[: len(whole)], ncols=len(whole))
        tidy(over, "over trials of a depth", "trial", "right, %")
        tidy(axes, "all trials", "", "")

    return Chart(
        "human_accuracy",
        "Right answers",
        "Share of right answers by depth, with 95 % intervals (Wilson) that count trials as independent. "
        "Dotted: chance.",
        3.2,
        ["depth_mm", "trial", "share", "low", "high", "of"],
        rows,
        draw,
    )
