"""The study ``stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.parallel import progress
from palp_core.palpation.studies.stability.algorithm import algorithm_cases
from palp_core.palpation.studies.stability.case import Case
from palp_core.palpation.studies.stability.charts import overview
from palp_core.palpation.studies.stability.elements import element_cases
from palp_core.palpation.studies.stability.joint import joint_cases

_HEAD = ("failing method", "symptom", "fails at", "survivor")


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure all cases, write table, chart and the page, and return the page."""
    measured: list[Case] = []
    groups = (joint_cases, element_cases)
    with progress("groups of cases", len(groups)) as advance:
        for group in groups:
            measured += group(quick=quick)
            advance()
    cases = [*measured, *algorithm_cases()]
    out.mkdir(parents=True, exist_ok=True)
    (out / "stability.md").write_text(markdown(cases), encoding="utf-8")
    return write_page(
        out / "index.html",
        "studies/stability.html",
        head=list(_HEAD),
        cases=cases,
        chart=picture(overview(measured), out),
    )


def markdown(cases: Sequence[Case]) -> str:
    """Return the table of ``docs/mechanics.md``, a row per case."""
    lines = [_HEAD, ("---",) * len(_HEAD), *(case.row for case in cases)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
