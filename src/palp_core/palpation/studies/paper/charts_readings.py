"""Figure 12 again by peak, contrast and whole trace, in both worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import BLUE, GREEN, GREY, INK, Chart, in_percent, legend, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Places = Mapping[str, Sequence[Mapping[str, Any]]]
_SHOWN = {"fixed_best": GREY, "markov": BLUE, "information_gain": GREEN}
_WIDTH = 0.27


def readings_chart(places: Places) -> Chart:
    """Best fixed position, human strategy and information gain, by what is read and when to stop.

    Args:
        places: Lines by world and scene, as of :func:`.by_readings`; worlds come first.
    """
    worlds = {name: places[name] for name in list(places)[:2]}

    def draw(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(len(worlds), 1, sharex=True))
        for axes, (world, lines) in zip(panels, worlds.items(), strict=True):
            at = np.arange(len(lines))
            for number, (policy, colour) in enumerate(_SHOWN.items()):
                there = [i for i, line in enumerate(lines) if policy in line["policies"]]
                found = [lines[i]["policies"][policy] for i in there]
                x = at[there] + _WIDTH * (number - 1)
                axes.bar(
                    x,
                    [one["accuracy"] for one in found],
                    width=_WIDTH,
                    color=colour,
                    label=policy.replace("_", " "),
                )
                axes.vlines(
                    x, [one["ci"][0] for one in found], [one["ci"][1] for one in found], color=INK, lw=1.2
                )
            axes.set_ylim(0.5, 1.02)
            in_percent(axes.yaxis)
            tidy(axes, f"world: {world}", "", "right, %")
        panels[-1].set_xticks(at, [_label(line) for line in lines])
        handles, words = panels[0].get_legend_handles_labels()
        legend(figure, handles=handles, labels=words, ncols=len(_SHOWN))

    return Chart(
        "readings",
        "Figure 12 again, by what is read off a sweep",
        "The paper's rule: its filter and stop rule (of the trace, the stop rule alone). Threshold: the "
        "filter that knows what stays, and a threshold on its belief. Swift: decided within the sweep. "
        "Bars: 95 % over sessions. The axis begins at 50 %; chance is a third.",
        5.2,
        ["place", "reading", "rule", "protocol", "policy", "accuracy", "low", "high", "seconds", "ece"],
        [
            [
                place,
                line["reading"],
                line["rule"],
                line["protocol"],
                policy,
                one["accuracy"],
                *one["ci"],
                one["seconds"],
                one["ece"],
            ]
            for place, lines in places.items()
            for line in lines
            for policy, one in line["policies"].items()
        ],
        draw,
    )


def _label(line: Mapping[str, Any]) -> str:
    rule = {"paper": "the paper's rule", "threshold": "threshold"}[line["rule"]]
    return f"{line['reading']}\n{'swift' if line['protocol'] == 'swift' else rule}"
