"""The study ``contact-stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.contact.case import FailureCase
from palp_core.palpation.studies.contact.cases_fem import fem_cases
from palp_core.palpation.studies.contact.cases_joint import joint_cases
from palp_core.palpation.studies.contact.cases_other import other_cases
from palp_core.palpation.studies.contact.map import METHODS, map_chart, points, verdicts
from palp_core.palpation.studies.contact.stability_charts import case_chart, overview
from palp_core.palpation.studies.toolkit.progress import followed, progress

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
        pictures=[picture(one, out) for one in (overview(cases), *map(case_chart, cases))],
        maps=[picture(map_chart(found, name), out) for name in METHODS],
    )


def markdown(cases: Sequence[FailureCase]) -> str:
    """Return the table of ``docs/mechanics.md``, a row per case."""
    lines = [_HEAD, ("---",) * len(_HEAD), *(case.row for case in cases)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
