"""Charts of the study ``actions``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]
_FORMS = "os^vDP*"
_COLOURS = (
    charts.GREY,
    charts.INK,
    charts.BLUE,
    charts.GREEN,
    charts.VERMILION,
    charts.PINK,
    charts.AMBER,
)


def action_chart(rows: Rows) -> charts.Chart:
    """Accuracy against seconds of the rig by what may be chosen, in each world."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    schemes = list(dict.fromkeys(row["scheme"] for row in rows))

    def draw(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(1, len(worlds), sharey=True))
        for axes, world in zip(panels, worlds, strict=True):
            for row in (row for row in rows if row["world"] == world):
                number = schemes.index(row["scheme"])
                axes.errorbar(
                    row["seconds"],
                    100.0 * row["accuracy"],
                    [[100.0 * (row["accuracy"] - row["ci"][0])], [100.0 * (row["ci"][1] - row["accuracy"])]],
                    [[row["seconds"] - row["seconds_ci"][0]], [row["seconds_ci"][1] - row["seconds"]]],
                    fmt=_FORMS[number],
                    color=_COLOURS[number],
                    markersize=7,
                    elinewidth=0.8,
                    label=row["scheme"],
                )
            charts.tidy(axes, f"world: {world}", "seconds of the rig a decision", "right, %")
        handles, _ = panels[0].get_legend_handles_labels()
        charts.legend(figure, handles=handles, ncols=4, fontsize=7.5)

    return charts.Chart(
        "actions",
        "What may be chosen for a sweep",
        "Every sweep is that of the most expected bits a second among what may be chosen, and ends once the "
        "belief is at 0.99. Bars: 95 % over sessions.",
        4.2,
        [
            "world",
            "scheme",
            "seconds",
            "seconds_low",
            "seconds_high",
            "accuracy",
            "low",
            "high",
            "ece",
            "probes",
        ],
        [
            [
                row["world"],
                row["scheme"],
                row["seconds"],
                *row["seconds_ci"],
                row["accuracy"],
                *row["ci"],
                row["ece"],
                row["probes"],
            ]
            for row in rows
        ],
        draw,
    )


def look_chart(rows: Rows) -> charts.Chart:
    """What a second look leaves unknown, against the seconds that it takes."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    looks = list(dict.fromkeys(row["look"] for row in rows))

    def draw(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(1, len(worlds)))
        for axes, world in zip(panels, worlds, strict=True):
            for row in (row for row in rows if row["world"] == world):
                number = looks.index(row["look"])
                low, high = row["missing_ci"]
                axes.errorbar(
                    row["more_seconds"],
                    row["missing_bits"],
                    [[row["missing_bits"] - low], [high - row["missing_bits"]]],
                    fmt=_FORMS[number],
                    color=_COLOURS[number + 1],
                    markersize=7,
                    elinewidth=0.8,
                    label=row["look"],
                )
            axes.set_ylim(bottom=0.0)
            charts.tidy(axes, f"world: {world}", "more seconds of the rig", "bits still missing")
        handles, _ = panels[0].get_legend_handles_labels()
        charts.legend(figure, handles=handles, ncols=len(looks), fontsize=7.5)

    return charts.Chart(
        "second_look",
        "What a second look is worth",
        "After one whole sweep at the stiffest ring: the same path back, once more, or once more with the "
        "ring landed anew. Up: minus the binary logarithm of the true depth's probability, on average; 1.58 "
        "before the first sweep. Bars: 95 % over sessions.",
        3.6,
        ["world", "look", "more_seconds", "missing_bits", "low", "high", "accuracy", "ece"],
        [
            [
                row["world"],
                row["look"],
                row["more_seconds"],
                row["missing_bits"],
                *row["missing_ci"],
                row["accuracy"],
                row["ece"],
            ]
            for row in rows
        ],
        draw,
    )
