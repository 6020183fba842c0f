"""The charts of a session that its record has numbers for."""

from __future__ import annotations

import json
from typing import Any

from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.session.charts.estimation import (
    belief_chart,
    calibration_chart,
    rings_chart,
)
from palp_core.palpation.session.charts.rig import rig_chart
from palp_core.palpation.session.charts.steps import steps_chart
from palp_core.palpation.session.charts.training import primitives_chart, sweeps_chart
from palp_core.palpation.session.recorded_session import RecordedSession
from palp_core.palpation.session.result import SessionResult
from palp_core.palpation.session.roles import roles_of


def charts_of(found: RecordedSession, summary: RunSummary, result: SessionResult) -> list[Chart]:
    """Return the charts that the record has numbers for, in the order of the page."""
    roles = roles_of(summary)
    sweeps = {
        "estimator": _as_read(summary, roles.params("estimator")),
        "from_m": roles.params("experiment").get("from_m"),
        "speed_m_s": roles.params("stage").get("sweep_speed_m_s", 0.020),
    }
    found_charts = (
        _drawing(found, summary, result),
        steps_chart(found, **sweeps),
        belief_chart(found),
        calibration_chart(found),
        rings_chart(found),
        primitives_chart(found),
        sweeps_chart(found, **sweeps),
    )
    return [chart for chart in found_charts if chart is not None]


def _drawing(found: RecordedSession, summary: RunSummary, result: SessionResult) -> Chart | None:
    """Return the drawing of what was simulated; None of a rig with devices, whose sizes nobody told."""
    if result.mechanics is None or not found.rows:
        return None
    return rig_chart(
        result.mechanics.scene,
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
