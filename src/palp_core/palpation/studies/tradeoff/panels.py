"""The three panels of the README's first picture, drawn from kept data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from palp_core.methods.measured import Measured
from palp_core.palpation.perception.strategy.policies import FixedRing
from palp_core.palpation.reporting.charts import (
    AMBER,
    BLUE,
    GREEN,
    GREY,
    INK,
    PINK,
    SKY,
    VERMILION,
    Chart,
    in_percent,
    legend,
    tidy,
)
from palp_core.palpation.studies.simulation.policies import fixed_name
from palp_core.palpation.studies.toolkit.pareto import pareto_front
from palp_core.palpation.studies.tradeoff.chart import draw_panel, hatch_point
from palp_core.palpation.studies.tradeoff.judge import Judgement
from palp_core.palpation.studies.tradeoff.labels import Labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = Mapping[str, Any]
TOO_SURE = 0.10
"""A decision whose stated confidence is by so much above its accuracy is not to be trusted."""

_RUNGS = {"l0": (SKY, "D"), "l2": (BLUE, "o"), "l4": (GREEN, "v"), "l5": (PINK, "P")}
_FAMILIES = {
    "fixed": ("one position", GREY, "s"),
    "markov": ("as people do", VERMILION, "^"),
    "uniform": ("any position", GREEN, "v"),
    "reposition": ("best position, re-homed", SKY, "D"),
    "information": ("information gain", BLUE, "o"),
}
_READINGS = {"contrast": ("by the contrast", AMBER, "*"), "trace": ("by the whole trace", PINK, "P")}
_STUDIED = {"fixed": fixed_name(FixedRing().ring_m), "reposition": "reposition_best"}
"""The register's policies as the studies call them, where they do not alike."""


def signature_chart(kept: Row) -> Chart:
    """Return the picture.

    Args:
        kept: The data, as ``signature.json`` has them.
    """

    def draw(to: Figure) -> None:
        first, second, third = to.subplots(1, 3)
        draw_contact(first, kept["contact"], kept["asked"])
        draw_decisions(second, kept["decisions"], kept["chosen"], kept["readings"])
        draw_rungs(third, kept["rungs"])

    return Chart(
        "signature",
        "Time against error",
        "",
        4.1,
        ("panel", "what", "time_s", "value", "chosen", "unstable"),
        [*_contact_rows(kept["contact"]), *_decision_rows(kept), *_rung_rows(kept["rungs"])],
        draw,
        width=12.0,
    )


def draw_contact(axes: Axes, points: Sequence[Row], asked: float) -> None:
    """Draw error of the peak against CPU, a point per rung and resolution."""
    names = Measured.__dataclass_fields__
    found = [
        Judgement(
            Measured(**{name: one[name] for name in names if name != "error"}, error=_number(one["error"])),
            one["at_home"],
            one["on_front"],
            one["chosen"],
            one["why_not"],
            one["survivor"],
        )
        for one in points
    ]
    draw_panel(axes, found, _RUNGS, asked)
    tidy(axes, "How wrong is the touch?", "CPU with nothing cached, s", "error of the peak torque")


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def draw_decisions(axes: Axes, rows: Sequence[Row], chosen: Row, readings: Sequence[Row]) -> None:
    """Draw accuracy against seconds on the rig; hollow: the paper's filter, hatched: too sure of itself.

    Args:
        axes: Where.
        rows: Decisions by the peak.
        chosen: The register's methods by task.
        readings: Decisions by contrast and by whole trace.
    """
    rows = sorted(rows, key=lambda row: -abs(row["seconds"]))
    front = _front(rows, "seconds", "accuracy")
    axes.plot(
        [x for x, _ in front], [y for _, y in front], color=GREY, lw=1.4, drawstyle="steps-post", zorder=1
    )
    for row in rows:
        _, colour, marker = _family(row["policy"])
        face = "none" if row["filter"] == "naive" else colour
        spot = (row["seconds"], row["accuracy"])
        if too_sure(row):
            _hatch_spot(axes, *spot)
        axes.scatter(*spot, marker=marker, s=26, facecolors=face, edgecolors=colour, linewidths=1.0, zorder=3)
        if is_chosen(row, chosen):
            axes.scatter(*spot, s=190, facecolors="none", edgecolors=INK, linewidths=1.4, zorder=4)
    for row in readings:
        _, colour, marker = _READINGS[row["reading"]]
        face = "none" if row["rule"] == "paper" else colour
        axes.scatter(
            row["seconds"], row["accuracy"], marker=marker, s=44, facecolors=face, edgecolors=colour, zorder=3
        )
    for name, colour, marker in (*_FAMILIES.values(), *_READINGS.values()):
        axes.plot([], [], marker, color=colour, markersize=5, label=name)
    _chance(axes)
    legend(axes, fontsize=7)
    axes.set_xscale("log")
    axes.set_ylim(0.28, 1.03)
    in_percent(axes.yaxis)
    tidy(axes, "How right is the decision?", "seconds on the rig a trial", "right of three depths, %")


def draw_rungs(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw agreement of decisions with the finest rung against CPU a trial; hatched: not vouched for."""
    able = [row for row in rows if row["agreement"] is not None]
    axes.set_xscale("log")
    costs = [row["cpu_s_per_trial"] for row in able] or [1.0]
    axes.set_xlim(min(costs) / 3.0, max(costs) * 4.0)
    axes.set_ylim(0.28, 1.06)
    _chance(axes)
    labels = Labels(axes)
    for row in able:
        colour, marker = _RUNGS[row["rung"]]
        spot = (row["cpu_s_per_trial"], row["agreement"])
        if row["unstable"]:
            hatch_point(axes, *spot)
        axes.scatter(*spot, marker=marker, s=42, color=colour, zorder=3)
        labels.keep_free(*spot)
        if row["chosen"]:
            axes.scatter(*spot, s=190, facecolors="none", edgecolors=INK, linewidths=1.4, zorder=4)
    for row in able:
        labels.write(row["rung"], row["cpu_s_per_trial"], row["agreement"], bold=row["chosen"])
    tidy(axes, "Which touch does a decision need?", "CPU a trial, s", "same decision as with l4, %")
    in_percent(axes.yaxis)


def _chance(axes: Axes) -> None:
    axes.axhline(1 / 3, color=INK, lw=0.9, ls=":")
    axes.annotate(
        "chance", (1.0, 1 / 3), xycoords=("axes fraction", "data"), fontsize=7, ha="right", va="bottom"
    )


def too_sure(row: Row) -> bool:
    """Whether decisions are stated to be surer than they are right, by :data:`TOO_SURE` and more."""
    return float(row["overconfidence"]) >= TOO_SURE


def is_chosen(row: Row, chosen: Row) -> bool:
    """Whether a line is what the register chooses: its policy, stop rule and filter."""
    policy = str(chosen.get("policy", ""))
    wanted = (_STUDIED.get(policy, policy), chosen.get("stop"), chosen.get("filter"))
    return wanted == (row["policy"], row["stop"], row["filter"])


def _family(policy: str) -> tuple[str, str, str]:
    return next(one for start, one in _FAMILIES.items() if policy.startswith(start))


def _hatch_spot(axes: Axes, x: float, y: float) -> None:
    axes.fill_between(
        [x / 1.09, x * 1.09], [y - 0.025] * 2, [y + 0.025] * 2, facecolor="none", edgecolor=VERMILION,
        hatch="//////", linewidth=0.0, alpha=0.6, zorder=0,
    )  # fmt: skip


def _front(rows: Sequence[Row], cost: str, value: str) -> list[tuple[float, float]]:
    best = pareto_front([row[cost] for row in rows], [-row[value] for row in rows])
    return [(rows[i][cost], rows[i][value]) for i in best]


def _contact_rows(points: Sequence[Row]) -> list[tuple[Any, ...]]:
    return [
        ("contact", f"{p['method']} {p['setting']}".strip(), p["cost_s"], p["error"], int(p["chosen"]),
         int(bool(p["why_not"])))
        for p in points
    ]  # fmt: skip


def _decision_rows(kept: Row) -> list[tuple[Any, ...]]:
    return [
        ("decision", f"{r['policy']} {r['stop']} {r['filter']}", r["seconds"], r["accuracy"],
         int(is_chosen(r, kept["chosen"])), int(too_sure(r)))
        for r in kept["decisions"]
    ] + [("decision", r["scheme"], r["seconds"], r["accuracy"], 0, 0) for r in kept["readings"]]  # fmt: skip


def _rung_rows(rows: Sequence[Row]) -> list[tuple[Any, ...]]:
    return [
        ("rung", f"{r['rung']} {r['filter']}", r["cpu_s_per_trial"], r["agreement"], int(r["chosen"]),
         int(r["unstable"]))
        for r in rows
    ]  # fmt: skip
