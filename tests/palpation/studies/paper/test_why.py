from dataclasses import replace

import pytest

from palp_core.palpation.studies.paper import why
from palp_core.palpation.studies.paper.why import (
    HYPOTHESES,
    NONE,
    WhyCase,
    cells,
    conditions_of,
    why_session,
)
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import FIXED
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.toolkit.parallel import Runner


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


def test_without_shared_errors_every_stiff_position_makes_progress_or_is_right_at_once() -> None:
    plan = WorldPlan(gel=Gel(), conditions=conditions_of((), 20))
    found = why_session(WhyCase(plan, FIXED[1:], correlation_stop=False), (1,))
    for one in found.values():
        assert one.right[:, -1].mean() >= max(0.99, one.right[:, 0].mean())


def test_errors_that_stay_cost_accuracy_and_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"control": (), "only H1": ("H1",), "all": tuple(HYPOTHESES)}
    monkeypatch.setattr(why, "cells", lambda: few)
    rows = why.why_rows(3, 10, Runner())
    assert [row["cell"] for row in rows] == list(few)
    assert rows[0]["accuracy"] > rows[1]["accuracy"] > rows[2]["accuracy"]
    for row in rows:
        assert row["ci"][0] <= row["accuracy"] <= row["ci"][1]
        assert row["progress_ci"][0] <= row["progress"] <= row["progress_ci"][1]
