"""Charts of the study ``mismatch``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]


def map_chart(rows: Rows, world: str) -> charts.Chart:
    """Accuracy of each scheme under each difference; crossed where it fails, ringed where the run says so."""
    own = [row for row in rows if row["world"] == world]
    schemes = list(dict.fromkeys(row["scheme"] for row in own))
    differences = list(dict.fromkeys(row["difference"] for row in own))
    cells = {(row["scheme"], row["difference"]): row for row in own}

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        values = np.array([[100.0 * cells[s, d]["accuracy"] for s in schemes] for d in differences])
        image = axes.imshow(values, vmin=30.0, vmax=100.0, cmap="cividis", aspect="auto")
        for i, d in enumerate(differences):
            for j, s in enumerate(schemes):
                cell = cells[s, d]
                mark = f"{values[i, j]:.0f}"
                if cell["accuracy"] < 0.95 or cell["ece"] > 0.05:
                    mark += " \u00d7"
                if cell["told_sessions"] >= 0.5 or cell["strange_trials"] >= 0.5:
                    mark += " !"
                charts.number(axes, j, i, mark)
        axes.set_xticks(range(len(schemes)), [s.replace(", ", "\n").replace("_", "\n") for s in schemes])
        axes.set_yticks(range(len(differences)), differences)
        axes.tick_params(labelsize=7.0, length=0)
        axes.grid(visible=False)
        figure.colorbar(image, ax=axes, label="right, %", shrink=0.6)

    return charts.Chart(
        f"mismatch_{world}",
        f"Trained in one world, judged in another: {world}",
        "Per cent of right decisions; every row is one difference of the trials from training. A cross: less "
        "than 95 % right, or a stated confidence off by more than 5 points. An exclamation mark: in at "
        "least half of the sessions the run itself says that its trials differ from training, or half of its "
        "trials fit nothing that was taught.",
        0.3 * len(differences) + 1.6,
        ["difference", "scheme", "accuracy", "low", "high", "ece", "told_sessions", "strange_trials"],
        [
            [
                row["difference"],
                row["scheme"],
                row["accuracy"],
                *row["ci"],
                row["ece"],
                row["told_sessions"],
                row["strange_trials"],
            ]
            for row in own
        ],
        draw,
    )


def power_chart(rows: Rows) -> charts.Chart:
    """How often the run says that readings do not fit, by difference, for the swift protocol."""
    own = [row for row in rows if row["scheme"].startswith("trace") and row["scheme"].endswith("swift")]
    own = [row for row in own if "fixed" in row["scheme"]]
    worlds = list(dict.fromkeys(row["world"] for row in own))

    def draw(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(1, len(worlds), sharey=True))
        for axes, world in zip(panels, worlds, strict=True):
            here = [row for row in own if row["world"] == world]
            place = np.arange(len(here))
            axes.barh(place, [100.0 * row["told_sessions"] for row in here], color=charts.BLUE, height=0.4)
            axes.barh(
                place + 0.4, [100.0 * row["strange_trials"] for row in here], color=charts.AMBER, height=0.4
            )
            axes.axvline(5.0, color=charts.VERMILION, linestyle="--", linewidth=1.0)
            axes.set_yticks(place + 0.2, [row["difference"] for row in here])
            axes.tick_params(labelsize=7.0)
            axes.invert_yaxis()
            charts.tidy(axes, f"world: {world}", "warned, %", "")

    return charts.Chart(
        "mismatch_power",
        "How often the run itself warns",
        "Blue: sessions of 300 trials that say by what their trials differ from training, held against what "
        "training's own mountings differ by. Amber: trials whose torque fits no better than one in "
        "twenty would. Dashed: 5 %, what may be warned of for nothing (the row none).",
        5.0,
        ["world", "difference", "told_sessions", "low", "high", "strange_trials"],
        [
            [row["world"], row["difference"], row["told_sessions"], *row["told_ci"], row["strange_trials"]]
            for row in own
        ],
        draw,
    )
