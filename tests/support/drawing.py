"""Charts that are made and drawn on, but not rendered: that is most of what a page takes."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from palp_core.palpation.reporting import charts
from palp_core.palpation.reporting.charts import Chart


def render_nothing(patch: pytest.MonkeyPatch) -> None:
    """Let every chart be drawn onto its figure, and its files hold no picture."""
    patch.setattr(charts, "image", sketch)


def sketch(chart: Chart, form: str) -> bytes:
    """Return a stand-in for a chart's picture, after it was drawn onto a figure."""
    chart.draw(Figure(figsize=(chart.width, chart.height), layout="constrained"))
    return form.encode()
