"""Every trap: ours survives it, and the check fails when the naive formula is put in place."""

import csv
import json
from pathlib import Path

import pytest

from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.decision.stability import TRAPS
from palp_core.palpation.studies.decision.trap import Trap, answer
from palp_core.palpation.studies.decision.trap_charts import map_chart


@pytest.mark.parametrize("trap", TRAPS, ids=lambda trap: trap.name)
def test_ours_survives(trap: Trap) -> None:
    found = answer(trap.ours)
    assert trap.survives(found), trap.words(found)


@pytest.mark.parametrize("trap", TRAPS, ids=lambda trap: trap.name)
def test_the_naive_formula_in_its_place_would_be_noticed(trap: Trap) -> None:
    found = answer(trap.naive)
    assert not trap.survives(found), trap.words(found)


def test_every_trap_is_a_row(tmp_path: Path) -> None:
    page = study("decision-stability").run(tmp_path)
    rows = json.loads((tmp_path / "decision_stability.json").read_text(encoding="utf-8"))
    names = [one["trap"] for one in rows]
    assert {f"T{n}" for n in range(1, 12)} <= {name.rstrip("bcd") for name in names}
    assert len(set(names)) == len(names)
    assert all(name in page.read_text(encoding="utf-8") for name in names)
    for name in ("traps", "decision_stability"):
        with (tmp_path / f"{name}.csv").open(encoding="utf-8") as file:
            assert len(list(csv.DictReader(file))) == len(rows)
    drawn = (tmp_path / "traps.svg").read_text(encoding="utf-8")
    assert drawn.count("<!-- ×") == len(rows)  # every naive way fails, none of ours


def failing(start: str) -> set[tuple[float, float]]:
    """Return where a naive way fails, as the map draws it."""
    return {(x, y) for name, _, x, _, y, fails in map_chart().rows if fails and name.startswith(start)}


def test_the_map_crosses_what_fails_on_a_labs_own_axes() -> None:
    outlier, stop, short = failing("densities"), failing("while"), failing("db10")
    assert {x / y > 5.0 for x, y in outlier} == {True}
    assert (0.1, 0.03) not in outlier  # three deviations off
    assert (30.0, 0.01) in outlier
    assert (90.0, 40.0) in stop
    assert not any(abs(x - y) <= 5.0 for x, y in stop)
    assert {y for x, y in short if x == 600.0} == {5.0, 6.0, 7.0}  # 608 samples at least for five levels
    assert not any(x == 4000.0 for x, _ in short)
