"""A trial's co-contraction with its bursts and peaks, as a chart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.identification.emg.trial import EmgTrial
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.reporting.charts import GREY, INK, Chart, depth_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def trial_chart(trial: EmgTrial) -> Chart:
    """Return the chart; its numbers are the peaks."""
    result, rate_hz = trial.analysis, trial.settings.rate_hz
    times_s = np.arange(result.cocontraction.size) / rate_hz
    shown = np.where(result.trusted, result.cocontraction, np.nan)
    peaks = [(peak.index / rate_hz, peak.value) for peak in result.peaks]
    levels = [int(level) + 1 for level in result.levels.index]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for level in LEVELS:
            axes.axhline(level, color=GREY, linewidth=0.5, linestyle=":")
        for one in result.bursts:
            axes.axvspan(one.begin / rate_hz, one.end / rate_hz, color=GREY, alpha=0.2, linewidth=0.0)
        axes.plot(times_s, shown, color=INK, linewidth=0.7)
        if peaks:
            style = depth_style(1) | {"linestyle": "none"}
            axes.plot(*zip(*peaks, strict=True), **style, markersize=4)
        axes.set_xlabel("time (s)")
        axes.set_ylabel("co-contraction (of MVC)")

    return Chart(
        name="cocontraction",
        title="Co-contraction and its bursts",
        caption="Normalised co-contraction, eq. (3); shaded are its bursts, squares the peaks within them, "
        "dotted lines the five levels, gaps are lost samples.",
        height=3.2,
        columns=("time_s", "cocontraction", "level"),
        rows=[[*peak, level] for peak, level in zip(peaks, levels, strict=True)],
        draw=draw,
    )
