"""Every trap: ours survives it, and the check fails when the naive formula is put in place."""

import csv
import json
from pathlib import Path

import pytest

from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.decision.stability import TRAPS
from palp_core.palpation.studies.decision.trap import Trap, answer


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
    with (tmp_path / "decision_stability.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == len(rows)
