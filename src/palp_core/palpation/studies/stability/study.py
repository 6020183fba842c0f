"""The study ``stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.stability import algorithm, mechanics
from palp_core.palpation.studies.stability.case import HEAD, Case, Row, Symptoms, measure
from palp_core.palpation.studies.summary import publish

CASES = {case.name: case for case in (*mechanics.CASES, *algorithm.CASES)}


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "") -> Path:
    """Measure all cases, write the table and the page, and return the page."""
    rows = measure_rows(list(CASES.values()), Runner(workers=workers, dask=dask), quick=quick)
    page = publish(
        out,
        "stability",
        [],
        report={"quick": quick, "rows": [dict(zip(HEAD, row.cells, strict=True)) for row in rows]},
        tables={"stability": tried(rows)},
        head=HEAD,
        rows=rows,
    )
    (out / "stability.md").write_text(markdown(rows), encoding="utf-8")
    return page


def measure_rows(cases: Sequence[Case], runner: Runner, *, quick: bool = False) -> list[Row]:
    """Return the rows of cases of :data:`CASES`."""
    found = runner.run_jobs(_measure_named, [(case.name, quick) for case in cases], label="cases")
    return [Row.of(case, symptoms, quick=quick) for case, symptoms in zip(cases, found, strict=True)]


def _measure_named(job: tuple[str, bool]) -> Symptoms:
    return measure(CASES[job[0]], quick=job[1])


def tried(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return both methods' symptoms at each value that was tried."""
    return [
        {"case": row.case.name, "value": value, "method": found, "survivor": kept, "limit": row.limit}
        for row in rows
        for value, found, kept in zip(row.values, row.of_method, row.of_survivor, strict=True)
    ]


def markdown(rows: Sequence[Row]) -> str:
    """Return the table of ``docs/results/mechanics.md``, a row per case."""
    lines = [HEAD, ("---",) * len(HEAD), *(row.cells for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
