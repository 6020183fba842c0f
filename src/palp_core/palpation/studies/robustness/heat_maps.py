"""How many points each policy lies from the best of the others, cell by cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import Chart, number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 50.0
"""Points at which the colours end."""


def to_best_chart(found: Sequence[Mapping[str, Any]], design: str, title: str) -> Chart:
    """Return the heat map of a design: a row a cell, a column a policy.

    Args:
        found: Of every cell, design and policy: ``difference`` to the best of the others, and its ``ci``.
        design: Which of them.
        title: Of the chart.
    """
    own = {(one["cell"], one["policy"]): one for one in found if one["design"] == design}
    cells, policies = (list(dict.fromkeys(key[place] for key in own)) for place in (0, 1))

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        points = np.array([[100.0 * own[cell, name]["difference"] for name in policies] for cell in cells])
        image = axes.imshow(points, vmin=-_MOST, vmax=_MOST, cmap="PuOr", aspect="auto")
        for y, cell in enumerate(cells):
            for x, name in enumerate(policies):
                words = f"{points[y, x]:+.0f}" + (" ×" if behind(own[cell, name]) else "")
                number(axes, x, y, words)
        axes.set_xticks(range(len(policies)), [name.replace("_", "\n") for name in policies])
        axes.set_yticks(range(len(cells)), cells)
        axes.tick_params(labelsize=8, length=0)
        axes.xaxis.tick_top()
        axes.grid(visible=False)
        figure.colorbar(image, ax=axes, shrink=0.5, label="percentage points to the best", extend="both")

    return Chart(
        f"robustness_to_best_{design}",
        title,
        "Accuracy less that of the best of the other policies, in percentage points; the best is chosen for "
        "each session by all other sessions. Orange: behind, violet: ahead. A cross: the 95 % interval over "
        "sessions lies below 0, so the policy is behind; this is each interval alone, so that of 40 one is "
        "marked by chance.",
        1.4 + 0.24 * len(cells),
        ("cell", "policy", "difference", "low", "high", "behind"),
        [(*key, one["difference"], *one["ci"], int(behind(one))) for key, one in own.items()],
        draw,
    )


def behind(one: Mapping[str, Any]) -> bool:
    """Whether the interval of a difference lies below 0."""
    return bool(one["ci"][1] < 0.0)
