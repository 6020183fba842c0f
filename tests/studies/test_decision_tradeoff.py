import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.perception.stopping import PaperVerbatim
from palp_core.studies import decision_tradeoff
from palp_core.studies.catalogue import study
from palp_core.studies.decision_limits import least_seconds, limits
from palp_core.studies.decision_tradeoff import FILTERS, pareto
from palp_core.studies.touch import Gel, touch
from palp_core.studies.virtual_rig import Conditions

points = st.lists(st.tuples(st.floats(0, 10), st.floats(0, 1)), min_size=1, max_size=8)


@given(points)
@settings(max_examples=40, deadline=None)
def test_the_front_is_what_no_other_beats(found: list[tuple[float, float]]) -> None:
    front = pareto(found)
    assert any(front)
    for (cost, share), on in zip(found, front, strict=True):
        beaten = any(c < cost and a > share for c, a in found)
        assert not (beaten and on)


def test_independent_readings_are_a_limit_that_rises_with_probes() -> None:
    found = limits(touch(Gel()), Conditions())
    for best in (found.independent, found.shared):
        by_probes = sorted(best, key=lambda one: one.probes)
        assert all(np.diff([one.accuracy for one in by_probes]) >= -1e-3)
        assert by_probes[-1].accuracy > 0.9
    assert found.chernoff_nats > 0.0
    assert found.independent[-1].accuracy > found.shared[-1].accuracy
    for limit in (found.fano, found.wald):
        assert all(np.diff([probes for probes, _ in limit]) > 0.0)
        assert all(np.diff([share for _, share in limit]) >= 0.0)
    assert found.wald_for == (4.0, 8.0, 16.0)


def test_seconds_grow_with_probes_and_hold_a_sweep_each() -> None:
    assert least_seconds(2.0) - least_seconds(1.0) == pytest.approx(9.0)
    assert least_seconds(1.0) > 8.0


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tradeoff")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decision_tradeoff, "UNKNOWN", Conditions(remount=True, trials=4))
        patch.setattr(decision_tradeoff, "POLICIES", ("fixed_16", "uniform", "information_gain_latent"))
        patch.setattr(decision_tradeoff, "STOPS", {"paper_verbatim": PaperVerbatim()})
        study("decision-tradeoff").run(folder, quick=True)
    return folder


def test_every_combination_is_a_row_with_its_calibration(out: Path) -> None:
    report = json.loads((out / "decision_tradeoff.json").read_text(encoding="utf-8"))
    keys = {(r["policy"], r["stop"], r["feature"], r["filter"]) for r in report["rows"]}
    assert len(keys) == len(report["rows"]) == 3 * 1 * 2 * len(FILTERS)
    for row in report["rows"]:
        assert {"accuracy", "ci", "probes", "seconds", "ece"} <= set(row)
    assert any(row["front_probes"] for row in report["rows"])


def test_the_reference_rung_agrees_with_itself_and_one_rung_is_chosen(out: Path) -> None:
    rungs = json.loads((out / "decision_tradeoff.json").read_text(encoding="utf-8"))["rungs"]
    assert all(r["agreement"] == 1.0 for r in rungs if r["rung"] == "l4" and not r["unstable"])
    assert {r["rung"] for r in rungs if r["chosen"]}
    assert {r["rung"] for r in rungs} == {"l0", "l1", "l2", "l3", "l4", "l5"}
    for row in rungs:
        assert (row["agreement"] is None) <= bool(row["words"])
        assert row["unstable"] == bool(row["words"])
    assert {"accuracy_against_probes", "accuracy_against_seconds", "decision_calibration"} <= {
        path.stem for path in out.glob("*.png")
    }
