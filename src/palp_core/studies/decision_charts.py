"""Charts of the study ``decision-tradeoff``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.perception.optimal import Optimum
from palp_core.studies.charts import GREY, INK, Chart, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["calibration_chart", "rungs_chart", "tradeoff_chart"]

Rows = Sequence[Mapping[str, Any]]
_FAMILIES = {"fixed": "#8a8a8a", "markov": "#D55E00", "uniform": "#009E73", "reposition": "#56B4E9"}
_GAIN = "#0072B2"


def _colour(policy: str) -> str:
    return next((c for family, c in _FAMILIES.items() if policy.startswith(family)), _GAIN)


def tradeoff_chart(rows: Rows, cost: str, best: Sequence[Optimum], rate: float) -> Chart:
    """Accuracy against probes or seconds; hollow: paper's filter, full: latent; ringed: the front."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for row in rows:
            colour = _colour(row["policy"])
            face = colour if row["filter"] == "latent" else "none"
            marker = "o" if row["feature"] == "peak" else "s"
            axes.plot(row[cost], row["accuracy"], marker, color=colour, markerfacecolor=face, markersize=4)
            if row[f"front_{cost}"]:
                axes.plot(row[cost], row["accuracy"], "o", color=INK, markerfacecolor="none", markersize=9)
        if best:
            ends = sorted((one.probes, one.accuracy) for one in best)
            axes.plot(
                *zip(*ends, strict=True), color=INK, linewidth=1.0, label="optimum, independent readings"
            )
            probes = np.linspace(0.0, 15.0, 100)
            law = 1.0 - (2.0 / 3.0) * np.exp(-rate * probes)
            axes.plot(probes, law, color=INK, linestyle=":", linewidth=1.0, label="Chernoff's rate")
            axes.axhline(1 / 3, color=GREY, linestyle="--", linewidth=0.8)
        for family, colour in {**_FAMILIES, "information gain": _GAIN}.items():
            axes.plot([], [], "o", color=colour, markersize=4, label=family)
        axes.legend(fontsize=7, loc="lower right")
        axes.set_ylim(0.3, 1.02)
        tidy(axes, "", "probes a trial" if cost == "probes" else "seconds a trial on the rig", "accuracy")

    return Chart(
        f"accuracy_against_{cost}",
        f"Accuracy against {cost}",
        "A dot is a policy, stop rule, feature and filter. Full: the filter that knows what stays; hollow: "
        "the paper's. Round: peak; square: contrast. Ringed: no other is faster and more accurate. Lines, "
        "where drawn: what dynamic programming reaches if every reading had errors of its own, and the "
        "asymptotic rate of such readings. With shared errors a policy cannot reach them by staying where "
        "it is.",
        (7.5, 4.6),
        ["policy", "stop", "feature", "filter", cost, "accuracy", "front"],
        [
            [r["policy"], r["stop"], r["feature"], r["filter"], r[cost], r["accuracy"], r[f"front_{cost}"]]
            for r in rows
        ],
        draw,
    )


def calibration_chart(rows: Rows) -> Chart:
    """Stated confidence against accuracy, both filters."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0.3, 1], [0.3, 1], color=GREY, linestyle=":")
        for name, colour in (("naive", "#D55E00"), ("latent", _GAIN)):
            these = [r for r in rows if r["filter"] == name]
            stated = [r["accuracy"] + r["overconfidence"] for r in these]
            axes.plot(stated, [r["accuracy"] for r in these], "o", color=colour, markersize=3.5, label=name)
        axes.legend(title="filter")
        tidy(axes, "", "mean stated confidence", "accuracy")

    return Chart(
        "decision_calibration",
        "Is the stated confidence deserved?",
        "A dot a combination. Below the line: surer than right.",
        (5.0, 3.8),
        ["policy", "stop", "feature", "filter", "stated", "accuracy", "ece"],
        [
            [
                r["policy"],
                r["stop"],
                r["feature"],
                r["filter"],
                r["accuracy"] + r["overconfidence"],
                r["accuracy"],
                r["ece"],
            ]
            for r in rows
        ],
        draw,
    )


def rungs_chart(rows: Rows) -> Chart:
    """Agreement of decisions with rung L4 against CPU a trial; the chosen rung ringed, unstable listed."""
    usable = [r for r in rows if r["agreement"] is not None]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for row in usable:
            colour = "#0072B2" if row["filter"] == "latent" else "#D55E00"
            marker = "o" if row["feature"] == "peak" else "s"
            axes.plot(row["cpu_s_per_trial"], row["agreement"], marker, color=colour, markersize=5)
            axes.annotate(
                row["rung"],
                (row["cpu_s_per_trial"], row["agreement"]),
                fontsize=7,
                xytext=(4, -3),
                textcoords="offset points",
            )
            if row["chosen"]:
                axes.plot(
                    row["cpu_s_per_trial"],
                    row["agreement"],
                    "o",
                    color=INK,
                    markerfacecolor="none",
                    markersize=10,
                )
        for name in {f"{r['rung']}, {r['feature']}" for r in rows if r["unstable"]}:
            axes.axvspan(0.0, 0.0, hatch="//", facecolor="none", edgecolor=GREY, label=f"unstable: {name}")
        if any(r["unstable"] for r in rows):
            axes.legend(fontsize=7)
        axes.set_xscale("log")
        tidy(axes, "", "CPU a trial, s", "same decision as with L4")

    return Chart(
        "decisions_by_rung",
        "End to end: which contact model do decisions need?",
        "Share of trials decided as with rung L4 on the same luck, against the CPU of a trial's sweeps and "
        "its filter, measured on this machine. Ringed: the rung that the register chooses. Blue: latent "
        "filter; orange: the paper's. Round: peak; square: contrast.",
        (6.0, 4.0),
        ["rung", "feature", "filter", "agreement", "cpu_s_per_trial", "chosen", "unstable", "words"],
        [
            [
                r["rung"],
                r["feature"],
                r["filter"],
                r["agreement"],
                r["cpu_s_per_trial"],
                r["chosen"],
                r["unstable"],
                r["words"],
            ]
            for r in rows
        ],
        draw,
    )
