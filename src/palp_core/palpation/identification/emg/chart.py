"""A trial's co-contraction with its bursts, as a chart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.identification.emg.trial import EmgTrial
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.reporting.charts import GREY, INK, Chart, depth_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def trial_chart(trial: EmgTrial) -> Chart:
    """Return the chart; its numbers are the bursts."""
    result, rate_hz = trial.analysis, trial.settings.rate_hz
    times_s = np.arange(result.cocontraction.size) / rate_hz
    shown = np.where(result.trusted, result.cocontraction, np.nan)
    bursts = [(burst.index / rate_hz, burst.value) for burst in result.bursts]
    levels = [int(level) + 1 for level in result.levels.index]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for level in LEVELS:
            axes.axhline(level, color=GREY, linewidth=0.5, linestyle=":")
        axes.plot(times_s, shown, color=INK, linewidth=0.7)
        if bursts:
            style = depth_style(1) | {"linestyle": "none"}
            axes.plot(*zip(*bursts, strict=True), **style, markersize=4)
        axes.set_xlabel("time (s)")
        axes.set_ylabel("co-contraction (of MVC)")

    return Chart(
        name="cocontraction",
        title="Co-contraction and its bursts",
        caption="Normalised co-contraction, eq. (3); squares are bursts, dotted lines the five levels, "
        "gaps are lost samples.",
        size=(9.0, 3.2),
        columns=("time_s", "cocontraction", "level"),
        rows=[[*burst, level] for burst, level in zip(bursts, levels, strict=True)],
        draw=draw,
    )
