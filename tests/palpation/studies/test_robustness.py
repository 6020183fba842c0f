"""The study ``robustness``: one factor at a time, invariants of its cells, and leads over the best."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.plan import Gel
from palp_core.palpation.studies.robustness import cases
from palp_core.palpation.studies.robustness import study as robustness
from palp_core.palpation.studies.robustness.cases import DESIGNS, DIFFERENCES, FACTORS, POLICIES, cells
from palp_core.palpation.studies.robustness.study import lead
from palp_core.palpation.studies.schemes import Case, Scheme, run_session
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.trace_table import TraceTable

CENTRE = cells()[0]


def changed(cell: Case) -> set[str]:
    """Return what a cell has otherwise than the centre."""
    found = set() if cell.schemes == CENTRE.schemes else {"chain"}
    for part in ("gel", "conditions"):
        own, usual = getattr(cell.plan, part), getattr(CENTRE.plan, part)
        found |= {one.name for one in fields(own) if getattr(own, one.name) != getattr(usual, one.name)}
    return found - {"height_reach_m"}


def test_one_factor_is_varied_at_a_time_and_quick_keeps_its_ends() -> None:
    found = cells()
    assert len({cell.name for cell in found}) == len(found)
    assert [cell.name for cell in found if not changed(cell)] == ["centre"]
    for factor in FACTORS:
        own = [cell for cell in found if cell.name.partition(": ")[0] == factor.name]
        assert all(len(changed(cell)) == 1 for cell in own)
        assert len({frozenset(changed(cell)) for cell in own if factor.name != "training order"}) <= 1
        assert len(own) == len(factor.values) - 1
        assert factor.centre in dict(factor.values)
    quick = cells(quick=True, trials=7)
    assert {cell.name.partition(": ")[0] for cell in quick} == {"centre", *(one.name for one in FACTORS)}
    assert {cell.plan.conditions.trials for cell in quick} == {7}
    assert {cell.name for cell in quick} <= {cell.name for cell in found}


GELS = sorted({cell.plan.gel for cell in cells(quick=True)}, key=repr)


@pytest.mark.parametrize("gel", GELS, ids=repr)
def test_without_stiffness_and_weight_nothing_is_felt_in_any_gel(gel: Gel) -> None:
    probe = Probe(friction=gel.friction, tip_radius_m=gel.tip_radius_m, tip_mass_kg=0.0)
    model = rung_model(gel.rung or "l4", gel.scene(0.004).phantom, gel.tip_radius_m)
    solved = solve(model, probe, 0.0, gel.indentation_m, -0.005, 0.02)
    assert np.abs(solved.torque_n_m(np.linspace(-0.004, 0.019, 50))).max() < 1e-12


@pytest.mark.parametrize(
    "name", ["centre", "distribution: two sided", "training: 5", "training order: re-mounted in blocks"]
)
def test_a_joint_that_feels_nothing_is_at_chance(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TraceTable, "_cell", lambda table, i, j, rows: np.zeros((len(rows), 80)))
    (cell,) = [one for one in cells(trials=40) if one.name == name]
    plan = WorldPlan(gel=Gel(rings_m=(0.0,)), conditions=cell.plan.conditions)
    slack = Case("slack", plan, (Scheme("fixed_0", "fixed_0"),))
    right = [run_session(slack, (1, n))["fixed_0"].ended.correct.mean() for n in range(6)]
    assert np.mean(right) == pytest.approx(1 / 3, abs=0.07)  # 720 trials, four standard errors


def shares_of(shares: Mapping[str, Sequence[float]]) -> dict[str, np.ndarray]:
    """Return accuracies by policy: one half, but for those given."""
    count = len(next(iter(shares.values())))
    return {name: np.array(shares.get(name, [0.5] * count)) for name in POLICIES}


def test_a_lead_is_over_the_best_of_the_others() -> None:
    shares = shares_of({"uniform": (0.7 + 0.01 * np.random.default_rng(0).random(16)).tolist()})
    found = [lead(shares, policy) for policy in ("markov", "uniform")]
    assert [one["best"] for one in found] == ["uniform", POLICIES[0]]
    assert [one["lead"] for one in found] == pytest.approx([-0.205, 0.205], abs=0.01)
    assert found[0]["lead_ci"][1] < 0.0 < found[1]["lead_ci"][0]
    assert lead(shares_of({"markov": [0.5] * 16}), "markov")["lead"] == 0.0


def test_the_best_of_many_equals_is_not_taken_for_better() -> None:
    rng = np.random.default_rng(1)
    leads = []
    for _ in range(60):
        noise = {name: (0.8 + 0.05 * rng.standard_normal(8)).tolist() for name in POLICIES}
        leads.append(lead(shares_of(noise), "information_gain")["lead"])
    assert np.mean(leads) == pytest.approx(0.0, abs=0.012)  # the largest mean is 0.03 above


FEW = ("centre", "training order: not re-homed")


def run_few(folder: Path, workers: int) -> bytes:
    few = [one for one in cells(trials=6) if one.name in FEW]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cases, "cells", lambda **_: few)
        patch.setattr(robustness, "QUICK", (3, 6))
        patch.setattr(cases, "DIFFERENCES", {"none": DIFFERENCES["none"]})
        patch.setattr(cases, "SCHEMES", cases.SCHEMES[:1])
        study("robustness").run(folder, quick=True, workers=workers)
    return (folder / "robustness.json").read_bytes()


@pytest.mark.slow
def test_the_study_writes_all_cells_alike_with_workers(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    whole = run_few(one, 1)
    assert run_few(two, 2) == whole
    report = json.loads(whole)
    for design in DESIGNS:
        for cell in FEW:
            own = [o["policy"] for o in report["records"] if (o["cell"], o["design"]) == (cell, design)]
            assert own == list(POLICIES)
    assert [row["world"] for row in report["differences"]] == ["paper", "lab"]
    page = (one / "index.html").read_text(encoding="utf-8")
    assert "Trained in one world, judged in another" in page
    assert "training order: not re-homed" in page
