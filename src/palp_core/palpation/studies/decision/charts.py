"""Charts of the study ``decision-limits``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.decision.limits import Limits, least_seconds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]
_FAMILIES = {
    "fixed": charts.GREY,
    "markov": charts.VERMILION,
    "uniform": charts.GREEN,
    "reposition": charts.SKY,
}
_GAIN = charts.BLUE
_FILTERS = {
    "naive": charts.VERMILION,
    "latent_ring": charts.AMBER,
    "latent_trial": charts.PINK,
    "latent": _GAIN,
}


def _colour(policy: str) -> str:
    return next((c for family, c in _FAMILIES.items() if policy.startswith(family)), _GAIN)


def tradeoff_chart(rows: Rows, cost: str, bounds: Limits) -> charts.Chart:
    """Accuracy against probes or seconds, with the limits; hollow: paper's filter, full: one that knows more.

    Args:
        rows: A combination each, with its ``front_`` marks.
        cost: ``probes`` or ``seconds``.
        bounds: The limits, in probes.
    """
    rated = [row for row in rows if row[cost] > 0.0]

    def at(probes: float) -> float:
        return probes if cost == "probes" else least_seconds(probes)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for row in rated:
            colour = _colour(row["policy"])
            face = "none" if row["filter"] == "naive" else colour
            marker = "o" if row["feature"] == "peak" else "s"
            axes.plot(
                row[cost],
                row["accuracy"],
                marker,
                color=colour,
                markerfacecolor=face,
                markersize=3,
                alpha=0.6,
            )
            if row[f"front_{cost}"]:
                axes.plot(
                    row[cost], row["accuracy"], "o", color=charts.INK, markerfacecolor="none", markersize=9
                )
        for name, line, points in _limit_lines(bounds):
            axes.plot([at(x) for x, _ in points], [y for _, y in points], line, linewidth=1.2, label=name)
        axes.axhline(1 / 3, color=charts.GREY, linestyle="--", linewidth=0.8)
        for family, colour in {**_FAMILIES, "information gain": _GAIN}.items():
            axes.plot([], [], "o", color=colour, markersize=4, label=family)
        axes.legend(fontsize=6.5, loc="lower right", ncols=2)
        axes.set_ylim(0.3, 1.02)
        if cost == "probes":
            axes.set_xlim(0.0, 15.5)
        charts.tidy(
            axes, "", "probes a trial" if cost == "probes" else "seconds a trial on the rig", "accuracy"
        )

    first, second, ring = bounds.wald_for
    return charts.Chart(
        f"accuracy_against_{cost}",
        f"Accuracy against {cost}",
        "A dot is a policy, stop rule, feature and filter. Full: a filter that knows what stays; hollow: the "
        "paper's. Round: peak; square: contrast, in which the height cancels. Ringed: no other is faster and "
        "more accurate. Lines are the limits of the peak, which the contrast may pass: the "
        "numerical optimum when landing and height stay as they do here (every probe where it tells most, "
        "given all that was read; the stop optimal); what dynamic programming reaches if every reading had "
        f"errors of its own, and Chernoff's asymptotic rate of such readings; Wald's bound for {first:g} "
        f"against {second:g} mm at r_a = {ring:g} mm alone, a looser question; what Fano's inequality "
        f"permits {bounds.capacity_bits:.2f} bits a reading, where readings are independent. With shared "
        "errors a policy cannot reach the last four by staying where it is; the difference of two positions "
        "may tell more than their sum. "
        + ("Limits in seconds take the shortest moves there are." if cost == "seconds" else "")
        + " A dot above the optimum is luck of its sessions, or uses that landings are not normal.",
        (7.5, 4.8),
        ["policy", "stop", "feature", "filter", cost, "accuracy", "front"],
        [
            *(
                [
                    r["policy"],
                    r["stop"],
                    r["feature"],
                    r["filter"],
                    r[cost],
                    r["accuracy"],
                    r[f"front_{cost}"],
                ]
                for r in rated
            ),
            *(
                [f"limit: {name}", "", "", "", at(x), y, ""]
                for name, _, points in _limit_lines(bounds)
                for x, y in points
            ),
        ],
        draw,
    )


def _limit_lines(bounds: Limits) -> list[tuple[str, str, Sequence[tuple[float, float]]]]:
    """Return name, style and points of every limit."""
    independent = sorted((one.probes, one.accuracy) for one in bounds.independent)
    shared = sorted((one.probes, one.accuracy) for one in bounds.shared)
    law = [(n, 1.0 - (2.0 / 3.0) * np.exp(-bounds.chernoff_nats * n)) for n in np.linspace(0.1, 6.0, 40)]
    return [
        ("optimum, errors that stay", "k-", shared),
        ("optimum, independent readings", "k--", independent),
        ("Chernoff's rate", "k:", [(float(n), float(p)) for n, p in law]),
        ("Wald, hardest two depths", "m-.", bounds.wald),
        ("Fano", "m:", bounds.fano),
    ]


def calibration_chart(rows: Rows) -> charts.Chart:
    """Stated confidence against accuracy, every filter."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0.3, 1], [0.3, 1], color=charts.GREY, linestyle=":")
        for name, colour in _FILTERS.items():
            these = [r for r in rows if r["filter"] == name]
            stated = [r["accuracy"] + r["overconfidence"] for r in these]
            axes.plot(stated, [r["accuracy"] for r in these], "o", color=colour, markersize=3.5, label=name)
        axes.legend(title="filter")
        charts.tidy(axes, "", "mean stated confidence", "accuracy")

    return charts.Chart(
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
        axes.legend(fontsize=7)
        axes.set_xscale("log")
        charts.tidy(axes, "", "CPU a trial, s", "same decision as with L4")

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
        (6.6, 4.4),
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
