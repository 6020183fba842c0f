"""What has come of the session: trials with their verdicts, accuracy, guards met."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.palpation.live_page.roles import session_folder
from palp_core.palpation.live_page.trials import TrialRow
from palp_core.palpation.perception.statistics.statistics import Proportion
from palp_core.view.pages.parts import Cell, table, text_element
from palp_core.view.source.protocol import ViewSource

MOST_ROWS = 30
MOST_GUARDS = 12


class OutcomePanel:
    """Tables that are made anew when something has come."""

    def __init__(self, source: ViewSource, monitor: RigMonitor) -> None:
        self._source, self._monitor = source, monitor
        self._shown: list[TrialRow] | None = None
        self._guards: list[str] | None = []
        self._has_results = False
        with ui.element("div").classes("rig-grid"):
            with ui.element("section"):
                text_element("h2", "Trials so far, the latest first")
                self._trials = ui.element("div").classes("rig-scroll").props('data-what="trials"')
            with ui.element("section"):
                text_element("h2", "Right so far")
                self._right = ui.element("div").props('data-what="right"')
                if monitor.has("ContactGuard"):
                    text_element("h2", "Guards met")
                    self._met = ui.element("div").props('data-what="guards"')
        self._where = ui.element("p").classes("quiet").props('data-what="results"')

    def show(self) -> None:
        rows = self._monitor.board.rows
        if rows != self._shown:
            self._shown = list(rows)
            _fill(self._trials, partial(_trials, rows))
            _fill(self._right, self._accuracy)
        if self._monitor.has("ContactGuard") and self._guards != self._monitor.guards:
            self._guards = self._monitor.guards
            _fill(self._met, partial(_guards, self._guards))
        if not self._has_results:
            self._show_results()

    def _show_results(self) -> None:
        folder = session_folder(self._source, self._monitor.topics)
        if folder is not None:
            self._has_results = True
            _fill(self._where, partial(_results, folder))

    def _accuracy(self) -> None:
        board = self._monitor.board
        overall = board.accuracy()
        if overall is None:
            text_element("div", "no trial is judged yet", "quiet")
        else:
            rows = [(f"{depth:g} mm", *_share(one)) for depth, one in board.by_depth().items()]
            table(
                ("Depth", "Right", "Of", "Share (95 %, this session only)"),
                [*rows, ("all", *_share(overall))],
            )
            if mixed := board.mixed_text():
                text_element("p", mixed)
            text_element(
                "p",
                "Phantoms come in blocks: the share of all tells whose block it is; look at each depth.",
                "quiet",
            )


def _fill(box: ui.element, put: Any) -> None:
    box.clear()
    with box:
        put()


def _results(folder: Path) -> None:
    text_element("span", "The record grows as the session goes on; its report is there at the end: ")
    text_element("code", str(folder / "report.html"))


def _share(one: Proportion) -> tuple[str, str, str]:
    share = f"{100 * one.value:.1f} % ({100 * one.low:.0f} to {100 * one.high:.0f})"
    return str(one.success_count), str(one.trial_count), share


def _trials(rows: list[TrialRow]) -> None:
    if not rows:
        text_element("div", "no trial is over yet", "quiet")
        return
    last = rows[: -MOST_ROWS - 1 : -1]
    titles = ("Trial", "Phantom", "True depth", "Found", "Sure", "Palpations", "Verdict", "")
    table(titles, [_cells(row) for row in last])
    if len(rows) > MOST_ROWS:
        text_element("div", f"and {len(rows) - MOST_ROWS} before", "quiet")


def _cells(row: TrialRow) -> tuple[Cell, ...]:
    found = row.verdict != "dropped"
    right: Cell = ""
    if row.right is not None:
        verdict = "right" if row.right else "wrong"
        right = partial(text_element, "span", verdict, verdict)
    return (
        str(row.number),
        row.code,
        "" if row.depth_mm is None else f"{row.depth_mm:g} mm",
        f"{row.estimate_mm:g} mm" if found else "",
        f"{row.confidence:.0%}".replace("%", " %") if found else "",
        str(row.probe_count),
        row.verdict,
        right,
    )


def _guards(guards: list[str] | None) -> None:
    if guards is None:
        text_element("div", "nothing heard yet", "quiet")
        return
    if not guards:
        text_element("div", "none: the simulated touch is within what its model vouches for", "quiet")
    with ui.element("ul").classes("rig-notes"):
        for one in guards[:MOST_GUARDS]:
            text_element("li", one)
    if len(guards) > MOST_GUARDS:
        text_element("div", f"and {len(guards) - MOST_GUARDS} before", "quiet")
