"""The study ``decision-stability``: every trap of the published algorithm, what is naive and what we do."""

from pathlib import Path
from typing import Any

from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.studies.decision import traps_belief, traps_signal
from palp_core.palpation.studies.decision.trap import Trap, answer
from palp_core.palpation.studies.decision.trap_charts import map_chart, traps_chart
from palp_core.whole_file import write_json

TRAPS: tuple[Trap, ...] = (*traps_belief.TRAPS, *traps_signal.TRAPS)


def row(trap: Trap) -> dict[str, Any]:
    """Spring a trap both ways and return what came out."""
    naive, ours = answer(trap.naive), answer(trap.ours)
    return {
        "trap": trap.name,
        "about": trap.about,
        "input": trap.input,
        "naive_way": trap.naive_way,
        "naive": trap.words(naive),
        "naive_survives": bool(trap.survives(naive)),
        "our_way": trap.our_way,
        "ours": trap.words(ours),
        "ours_survives": bool(trap.survives(ours)),
    }


def run(out: Path, *, quick: bool = False) -> Path:  # noqa: ARG001  it is quick
    """Spring every trap, write the table as CSV and JSON, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Makes no difference.
    """
    rows = [row(trap) for trap in TRAPS]
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "decision_stability.json", rows)
    write_records(out / "decision_stability.csv", rows)
    return write_page(
        out / "index.html",
        "studies/decision_stability.html",
        traps=rows,
        pictures=[picture(chart, out) for chart in (traps_chart(rows), map_chart())],
    )
