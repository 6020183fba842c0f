import json
from dataclasses import replace
from pathlib import Path

import pytest

from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.paper import why as why_study
from palp_core.palpation.studies.paper.why import (
    HYPOTHESES,
    NONE,
    WhyJob,
    cells,
    conditions_of,
    grid,
    why_session,
)
from palp_core.palpation.studies.simulation.policies import FIXED
from palp_core.palpation.studies.simulation.reading_table import Gel, tabulate


def test_every_hypothesis_is_run_alone_and_left_out() -> None:
    found = cells()
    assert len(found) == 2 + 2 * len(HYPOTHESES)
    for name in HYPOTHESES:
        assert found[f"only {name}"] == (name,)
        assert name not in found[f"all but {name}"]
    assert conditions_of((), 40) == replace(NONE, trials=40)


def test_what_is_left_out_is_gone() -> None:
    """H2 has the ring's error of H1 in it: all but H1 was the same run as all."""
    whole = conditions_of(cells()["all"], 40)
    for name, (_, sets) in HYPOTHESES.items():
        if sets:
            assert conditions_of(cells()[f"all but {name}"], 40) != whole
    assert conditions_of(cells()["all but H1"], 40).repeatability_m == 0.0


def test_every_switch_is_crossed_with_every_other() -> None:
    found = grid(4)
    assert len(found) == 2**5
    assert len({(repr(conditions), policy) for conditions, policy in found.values()}) == 2**5


def test_without_shared_errors_every_stiff_position_makes_progress_or_is_right_at_once() -> None:
    felt = tabulate(Gel())
    found = why_session(WhyJob(felt, conditions_of((), 20), (1,), FIXED[1:], correlation_stop=False))
    for one in found.values():
        assert one.right[:, -1].mean() >= max(0.99, one.right[:, 0].mean())


def test_the_study_writes_its_page_table_and_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"control": (), "only H1": ("H1",), "all": tuple(HYPOTHESES)}
    one = dict(list(grid(4).items())[:2])
    monkeypatch.setattr(why_study, "cells", lambda: few)
    monkeypatch.setattr(why_study, "grid", lambda _: one)
    page = study("why").run(tmp_path, quick=True)
    report = json.loads((tmp_path / "why.json").read_text(encoding="utf-8"))
    assert [row["cell"] for row in report["cells"]] == list(few)
    assert len(report["grid"]) == 2
    assert report["cells"][0]["accuracy"] > report["cells"][2]["accuracy"]
    assert list(report["control"]) == list(FIXED[1:])
    for first, last in report["control"].values():
        assert last >= max(first, 0.99)
    assert "Which hypotheses suffice?" in page.read_text(encoding="utf-8")
