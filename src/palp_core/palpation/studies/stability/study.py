"""The study ``stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.stability.case import Case
from palp_core.palpation.studies.stability.cases_belief import belief_cases
from palp_core.palpation.studies.stability.cases_fem import fem_cases
from palp_core.palpation.studies.stability.cases_joint import joint_cases
from palp_core.palpation.studies.stability.cases_other import other_cases
from palp_core.palpation.studies.stability.cases_signal import signal_cases
from palp_core.palpation.studies.stability.charts import overview
from palp_core.palpation.studies.toolkit.progress import followed

_HEAD = ("failing method", "symptom", "fails at", "survivor")


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure all cases, write table, chart and the page, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few values of each parameter.
    """
    groups = followed("groups of cases", (joint_cases, other_cases, fem_cases))
    measured = [case for group in groups for case in group(quick=quick)]
    cases = [*measured, *belief_cases(), *signal_cases()]
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
