"""The report of a session: ``result.json``, ``report.html`` and ``charts/``, written when a run ended well.

A launch file names it: ``report: palp_core.palpation.session.report:session``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import picture
from palp_core.palpation.session.estimation_charts import (
    accuracy_chart,
    belief_chart,
    calibration_chart,
    rings_chart,
)
from palp_core.palpation.session.recorded_session import RecordedSession, read_session
from palp_core.palpation.session.recorded_sweeps import read_sweeps
from palp_core.palpation.session.repeatability import (
    is_repeatability,
    measure_repeatability,
    repeatability_headline,
    write_repeatability,
)
from palp_core.palpation.session.report_page import headline, write_report
from palp_core.palpation.session.result_json import build, out_of, write_result
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.training_charts import primitives_chart, sweeps_chart

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary


def session(summary: RunSummary) -> str:
    """Write the result, the charts and the page beside the record that a run has just left.

    Returns:
        The result in words, and where the page is.

    Raises:
        PalpError: The run names no folder, or there is no record in it.
    """
    found = read_session(out_of(summary))
    result = build(found, summary)
    write_result(result, found.folder)
    if is_repeatability([row.phase for row in found.rows]):
        return _repeatability(found, summary)
    pictures = [picture(one, found.folder / "charts", svg=False) for one in _charts(found, roles_of(summary))]
    target = write_report(found.folder / "report.html", result, pictures)
    return f"{headline(result)}\nReport: {target}"


def _repeatability(found: RecordedSession, summary: RunSummary) -> str:
    """Write the noise file and the page of the plan ``repeatability``."""
    path = roles_of(summary).params("phantom").get("scene", "")
    measured = measure_repeatability(read_sweeps(found.folder), scene=read_scene(path) if path else None)
    write_repeatability(measured, found.folder)
    return f"{repeatability_headline(measured)}\nReport: {found.folder / 'report.html'}"


def _charts(found: RecordedSession, roles: Roles) -> Iterator[Chart]:
    """Yield the charts that the record has numbers for, in the order of the page."""
    for chart in (
        accuracy_chart(found),
        belief_chart(found),
        calibration_chart(found),
        rings_chart(found),
        primitives_chart(found),
        sweeps_chart(
            found,
            estimator=roles.params("estimator"),
            from_m=roles.params("experiment").get("from_m"),
            speed_m_s=roles.params("stage").get("sweep_speed_m_s", 0.020),
        ),
    ):
        if chart is not None:
            yield chart
