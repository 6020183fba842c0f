"""Charts of the study ``decision-limits``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from palp_core.palpation.reporting import charts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]
_GAIN = charts.BLUE
_FILTERS = {
    "naive": charts.VERMILION,
    "latent": _GAIN,
}


def calibration_chart(rows: Rows) -> charts.Chart:
    """Stated confidence against accuracy, every filter."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0.3, 1], [0.3, 1], color=charts.GREY, linestyle=":")
        for name, colour in _FILTERS.items():
            these = [r for r in rows if r["filter"] == name]
            stated = [r["accuracy"] + r["overconfidence"] for r in these]
            axes.plot(stated, [r["accuracy"] for r in these], "o", color=colour, markersize=3.5, label=name)
        charts.legend(axes, "filter")
        charts.in_percent(axes.xaxis)
        charts.in_percent(axes.yaxis)
        charts.tidy(axes, "", "mean stated confidence, %", "right, %")

    return charts.Chart(
        "decision_calibration",
        "Is the stated confidence deserved?",
        "A dot a combination. Below the line: surer than right.",
        3.8,
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


def rungs_chart(rows: Rows) -> charts.Chart:
    """Agreement of decisions with rung L4 against CPU a trial.

    The chosen rung is ringed; hatched: a rung that vouches for nothing here, or could not serve, by name.
    """
    usable = [r for r in rows if r["agreement"] is not None]
    idle = {r["rung"]: r["words"] for r in rows if r["agreement"] is None}
    doubtful = {r["rung"]: r for r in usable if r["unstable"]}

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for row in usable:
            spot = (row["cpu_s_per_trial"], row["agreement"])
            marker = "o" if row["feature"] == "peak" else "s"
            axes.plot(*spot, marker, color=_FILTERS[row["filter"]], markersize=5)
            if row["chosen"]:
                axes.plot(*spot, "o", color=charts.INK, markerfacecolor="none", markersize=10)
        for rung in {r["rung"] for r in usable}:
            own = [(r["cpu_s_per_trial"], r["agreement"]) for r in usable if r["rung"] == rung]
            low, high = min(x for x, _ in own), max(x for x, _ in own)
            axes.annotate(
                rung, (high, min(y for _, y in own)), fontsize=7, xytext=(5, -3), textcoords="offset points"
            )
            if rung in doubtful:
                axes.axvspan(
                    low / 1.3, high * 1.3, hatch="//", facecolor="none", edgecolor=charts.GREY, linewidth=0
                )
        if idle:
            words = "not drawn: " + "; ".join(f"{rung}: {why}" for rung, why in sorted(idle.items()))
            figure.supxlabel(words if len(words) < 100 else words[:97] + "...", fontsize=7)
        for name, colour in _FILTERS.items():
            if any(r["filter"] == name for r in usable):
                axes.plot([], [], "o", color=colour, markersize=4, label=f"{name} filter")
        charts.legend(axes)
        axes.set_xscale("log")
        charts.in_percent(axes.yaxis)
        charts.tidy(axes, "", "CPU a trial, s", "same decision as with L4, %")

    words = "; ".join(f"{rung}: {why}" for rung, why in sorted(idle.items()))
    hatched = "; ".join(f"{rung}: {row['words']}" for rung, row in sorted(doubtful.items()))
    return charts.Chart(
        "decisions_by_rung",
        "End to end: which contact model do decisions need?",
        "Share of trials decided as with rung L4 on the same luck, against the CPU of a trial's sweeps and "
        "its filter, measured on this machine; setting up a rung once a gel is not counted. Ringed: the rung "
        "that the register chooses. Round: peak; square: contrast."
        + (f" Hatched, because unstable here: {hatched}." if hatched else "")
        + (f" Not drawn: {words}." if words else ""),
        4.4,
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
