"""The study ``contact-stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.reporting.charts import BLUE, GREY, PALE_GREEN, VERMILION, Chart, tidy
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.contact.case import FailureCase
from palp_core.palpation.studies.contact.cases_fem import fem_cases
from palp_core.palpation.studies.contact.cases_joint import joint_cases
from palp_core.palpation.studies.contact.cases_other import other_cases
from palp_core.palpation.studies.contact.map import METHODS, map_chart, points, verdicts
from palp_core.palpation.studies.toolkit.progress import followed, progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FAILING, _SURVIVOR = VERMILION, BLUE
_HUGE = 1e6
_HEAD = ("failing method", "symptom", "fails at", "survivor")


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure all cases and the map, write charts, tables and the page, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few values of each parameter and a small map.
    """
    groups = followed("groups of cases", (joint_cases, other_cases, fem_cases))
    cases = [case for group in groups for case in group(quick=quick)]
    with progress("points of the map", len(list(points(quick=quick)))) as advance:
        found = verdicts(quick=quick, progress=advance)
    out.mkdir(parents=True, exist_ok=True)
    (out / "stability.md").write_text(markdown(cases), encoding="utf-8")
    return write_page(
        out / "index.html",
        "studies/contact_stability.html",
        head=list(_HEAD),
        cases=cases,
        pictures=[picture(one, out) for one in (_overview(cases), *map(_case_chart, cases))],
        maps=[picture(map_chart(found, name), out) for name in METHODS],
    )


def markdown(cases: Sequence[FailureCase]) -> str:
    """Return the table of ``docs/mechanics.md``, a row per case."""
    lines = [_HEAD, ("---",) * len(_HEAD), *(case.row for case in cases)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _overview(cases: Sequence[FailureCase]) -> Chart:
    """Return all cases as bars over their parameters."""

    def draw(to: Figure) -> None:
        axes = to.subplots()
        for i, case in enumerate(reversed(cases)):
            edges = np.linspace(0.0, 1.0, len(case.values) + 1)
            for k, bad in enumerate(case.failed):
                axes.barh(
                    i, edges[k + 1] - edges[k], left=edges[k], height=0.62,
                    color=_FAILING if bad else PALE_GREEN, hatch="///" if bad else None, edgecolor="white",
                    linewidth=0,
                )  # fmt: skip
            axes.text(0.0, i + 0.36, f"{case.values[0]:.5g}", fontsize=6.5, color=GREY)
            axes.text(1.0, i + 0.36, f"{case.values[-1]:.5g}", fontsize=6.5, color=GREY, ha="right")
        axes.set_yticks(
            range(len(cases)), [f"{c.failing}\n{c.parameter}" for c in reversed(cases)], fontsize=7
        )
        axes.set_xticks([])
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(-0.5, len(cases) - 0.3)
        axes.grid(visible=False)
        axes.set_title("where a method fails: orange, hatched", loc="left", fontweight="bold")

    return Chart(
        "stability",
        "All cases",
        "One bar per failing method, over the values of its parameter that were tried, evenly spaced from "
        "the first to the last; both are written over the bar.",
        (9.0, 0.8 + 0.55 * len(cases)),
        (
            "case",
            "failing",
            "survivor",
            "parameter",
            "value",
            "symptom",
            "of_failing",
            "of_survivor",
            "limit",
            "failed",
        ),
        [
            (c.name, c.failing, c.survivor, c.parameter, value, c.symptom, bad, good, c.limit, int(failed))
            for c in cases
            for value, bad, good, failed in zip(c.values, c.of_failing, c.of_survivor, c.failed, strict=True)
        ],
        draw,
    )


def _case_chart(case: FailureCase) -> Chart:
    def draw(to: Figure) -> None:
        axes = to.subplots()
        shown = np.minimum(np.where(np.isfinite(case.of_failing), case.of_failing, _HUGE), _HUGE)
        floor = case.limit * 1e-4
        axes.plot(case.values, np.maximum(shown, floor), color=_FAILING, marker="o", ms=3, label=case.failing)
        axes.plot(
            case.values, np.maximum(case.of_survivor, floor), color=_SURVIVOR, ls="--", marker="s", ms=3,
            label=f"survivor: {case.survivor}",
        )  # fmt: skip
        axes.axhline(case.limit, color=GREY, lw=0.8, ls=":")
        axes.set_yscale("log")
        if case.logarithmic:
            axes.set_xscale("log")
        axes.legend(fontsize=7, loc="best")
        tidy(axes, case.symptom, case.parameter, "")

    return Chart(
        f"case_{case.name}",
        f"{case.failing}: fails {case.threshold}",
        f"{case.why} Dotted: the limit. Values below a ten-thousandth of it are drawn there.",
        (6.4, 3.4),
        (case.parameter, "failing", "survivor", "limit", "failed"),
        [
            (value, bad, good, case.limit, int(failed))
            for value, bad, good, failed in zip(
                case.values, case.of_failing, case.of_survivor, case.failed, strict=True
            )
        ],
        draw,
    )
