import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.perception.belief.stopping import PaperVerbatim
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.robustness import differences
from palp_core.palpation.studies.robustness import study as robustness_study
from palp_core.palpation.studies.robustness.cells import CENTRE, FACTORS, RobustnessCell, cells
from palp_core.palpation.studies.robustness.charts import lead_chart
from palp_core.palpation.studies.robustness.differences import DIFFERENCES, SCHEMES
from palp_core.palpation.studies.robustness.runs import DESIGNS, POLICIES, CellJob, run_cell, to_best
from palp_core.palpation.studies.robustness.study import RobustnessSize
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import begin_trained, run_policy
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trace_table import TraceTable
from palp_core.palpation.studies.toolkit.parallel import seeds

PAPER = ("paper",)
Records = list[dict[str, Any]]


def lines_of(records: Records) -> dict[str, dict[str, Any]]:
    """Records by policy."""
    return {one["policy"]: one for one in records}


def named(name: str, trials: int = 10) -> RobustnessCell:
    return next(cell for cell in cells(trials=trials) if cell.name == name)


def changed(cell: RobustnessCell) -> set[str]:
    """What a cell has otherwise than the centre."""
    found = {"chain"} if cell.chain != CENTRE.chain else set()
    for part in ("gel", "conditions"):
        own, usual = getattr(cell.plan, part), getattr(CENTRE.plan, part)
        found |= {one.name for one in fields(own) if getattr(own, one.name) != getattr(usual, one.name)}
    return found - {"height_reach_m"}


def test_one_factor_is_varied_at_a_time() -> None:
    found = cells()
    assert len({cell.name for cell in found}) == len(found)
    assert [cell.name for cell in found if not changed(cell)] == ["centre"]
    for factor in FACTORS:
        of_factor = [cell for cell in found if cell.factor == factor.name]
        assert all(len(changed(cell)) == 1 for cell in of_factor)
        assert len({frozenset(changed(cell)) for cell in of_factor if cell.factor != "training order"}) <= 1
        assert len(of_factor) == len(factor.values) - 1
        assert factor.centre in dict(factor.values)


def test_quick_keeps_the_ends_of_every_factor() -> None:
    quick = cells(quick=True, trials=7)
    assert {cell.factor for cell in quick} == {"", *(factor.name for factor in FACTORS)}
    assert {cell.plan.conditions.trials for cell in quick} == {7}
    assert {cell.name for cell in quick} <= {cell.name for cell in cells()}


GELS = sorted({cell.plan.gel for cell in cells()}, key=repr)


@pytest.mark.parametrize("gel", GELS, ids=repr)
def test_without_stiffness_and_weight_nothing_is_felt_in_any_gel(gel: Gel) -> None:
    probe = Probe(friction=gel.friction, tip_radius_m=gel.tip_radius_m, tip_mass_kg=0.0)
    for depth_m in gel.depths_m:
        model = rung_model(gel.rung or "l4", gel.scene(depth_m).phantom, gel.tip_radius_m)
        solved = solve(model, probe, 0.0, gel.indentation_m, -0.005, 0.02)
        assert np.abs(solved.torque_n_m(np.linspace(-0.004, 0.019, 50))).max() < 1e-12


CONDITIONS = sorted({cell.plan.conditions for cell in cells(trials=40)}, key=repr)


@pytest.mark.parametrize("number", range(len(CONDITIONS)))
def test_a_joint_that_feels_nothing_is_at_chance_in_every_cell(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TraceTable, "_cell", lambda table, i, j, rows: np.zeros((len(rows), 80)))
    plan = WorldPlan(gel=Gel(rings_m=(0.0,)), conditions=CONDITIONS[number])
    right = [
        run_policy("fixed_0", begin_trained(plan, (1, n)), PaperVerbatim()).correct.mean() for n in range(6)
    ]
    assert np.mean(right) == pytest.approx(1 / 3, abs=0.07)  # 720 trials, four standard errors


@pytest.mark.slow
@pytest.mark.parametrize("name", ["modulus: 5", "modulus: 30", "friction: 0.8"])
def test_without_shared_errors_every_stiff_position_is_right(name: str) -> None:
    gel = replace(named(name).plan.gel, rings_m=figure5.RINGS_M[1:])
    steady = replace(CENTRE.plan.conditions, repeatability_m=0.0, height_sd_m=0.0, trials=30)
    session = begin_trained(WorldPlan(gel=gel, conditions=steady), (2,))
    for mm in (4, 8, 12, 16):
        assert run_policy(f"fixed_{mm}", session, PaperVerbatim()).correct.mean() >= 0.99


@pytest.mark.slow
def test_intervals_shrink_with_sessions() -> None:
    every = seeds(3, 1, 16)
    groups = [every, *(every[i : i + 4] for i in range(0, 16, 4))]
    many, *few = (lines_of(run_cell(CellJob(named("centre"), PAPER, tuple(group)))) for group in groups)
    for policy in ("fixed_8", "markov", "uniform"):
        for key in ("accuracy", "probes", "seconds", "ece"):
            wide = [lines[policy][f"{key}_high"] - lines[policy][f"{key}_low"] for lines in (many, *few)]
            assert wide[0] < np.mean(wide[1:])


SLOW_CELLS = ("repeatability: 0.6", "height sd: 0.4", "training: 5")


@pytest.mark.parametrize("name", ["centre", *(pytest.param(n, marks=pytest.mark.slow) for n in SLOW_CELLS)])
def test_the_best_fixed_position_is_no_worse_than_their_average_anywhere(name: str) -> None:
    lines = lines_of(run_cell(CellJob(named(name, 20), PAPER, tuple(seeds(3, 1, 6)))))
    assert lines["fixed_best"]["accuracy"] >= lines["fixed_average"]["accuracy"]


def shares_of(shares: Mapping[str, Sequence[float]]) -> dict[str, np.ndarray]:
    """Accuracies by policy: one half, but for those given."""
    count = len(next(iter(shares.values())))
    return {name: np.array(shares.get(name, [0.5] * count)) for name in POLICIES}


def test_a_heat_map_crosses_what_is_behind_and_nothing_else() -> None:
    shares = shares_of({"uniform": (0.7 + 0.01 * np.random.default_rng(0).random(16)).tolist()})
    found = [
        {"cell": "centre", "design": "paper", "policy": policy, **to_best(shares, policy)}
        for policy in ("markov", "uniform", "information_gain")
    ]
    assert (found[0]["best"], found[1]["best"]) == ("uniform", POLICIES[0])
    assert found[0]["lead"] == pytest.approx(-0.205, abs=0.01)
    assert to_best(shares_of({"markov": [0.5] * 16}), "markov")["lead"] == 0.0
    figure = Figure()
    chart = lead_chart(found, "paper", "Points")
    chart.draw(figure)
    assert [words.get_text() for words in figure.axes[0].texts] == ["-21 ×", "+21", "-21 ×"]
    assert [row[-1] for row in chart.rows] == [1, 0, 1]
    assert [words.get_text() for words in figure.axes[0].get_yticklabels()] == ["centre"]


def test_the_best_of_many_equals_is_not_taken_for_better() -> None:
    rng = np.random.default_rng(1)
    leads = []
    for _ in range(60):
        noise = {name: (0.8 + 0.05 * rng.standard_normal(8)).tolist() for name in POLICIES}
        leads.append(to_best(shares_of(noise), "information_gain")["lead"])
    assert np.mean(leads) == pytest.approx(0.0, abs=0.012)  # the largest mean is 0.03 above


def run_few(folder: Path, workers: int) -> None:
    few = [named("centre", 6), named("training order: not re-homed", 6)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robustness_study, "cells", lambda **_: few)
        patch.setattr(robustness_study, "QUICK", RobustnessSize(sessions=3, trials=6))
        patch.setattr(robustness_study, "FEW_DIFFERENCES", DIFFERENCES[:2])
        patch.setattr(differences, "SCHEMES", SCHEMES[:1])
        study("robustness").run(folder, quick=True, workers=workers)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robustness")
    run_few(folder / "one", 1)
    return folder


@pytest.mark.slow
def test_the_workers_do_not_change_the_results(out: Path, tmp_path: Path) -> None:
    run_few(tmp_path, 2)
    one, two = ((folder / "robustness.json").read_bytes() for folder in (out / "one", tmp_path))
    assert one == two


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_with_what_it_has(out: Path, tmp_path: Path) -> None:
    """The line of a cell was cut short: that cell alone is run again, and its line is the last."""
    lines = (out / "one" / "cells.jsonl").read_text(encoding="utf-8").splitlines()
    cut = [*lines[1:], lines[0][:100]]
    (tmp_path / "cells.jsonl").write_text("\n".join(cut), encoding="utf-8")
    run_few(tmp_path, 1)
    assert (tmp_path / "cells.jsonl").read_text(encoding="utf-8").splitlines() == [*cut, lines[0]]
    assert (tmp_path / "robustness.json").read_bytes() == (out / "one" / "robustness.json").read_bytes()


@pytest.mark.slow
def test_the_study_writes_every_cell_its_charts_and_its_answer(out: Path) -> None:
    report = json.loads((out / "one" / "robustness.json").read_text(encoding="utf-8"))
    assert list(dict.fromkeys(one["cell"] for one in report["records"])) == [
        "centre",
        "training order: not re-homed",
    ]
    for design in DESIGNS:
        for cell in ("centre", "training order: not re-homed"):
            own = [
                one["policy"] for one in report["records"] if (one["cell"], one["design"]) == (cell, design)
            ]
            assert own == list(POLICIES)
    assert [(one["world"], one["difference"]) for one in report["differences"]] == [
        (world, one.name) for world in ("paper", "lab") for one in DIFFERENCES[:2]
    ]
    assert {path.stem for path in (out / "one").glob("*.png")} == {
        "robustness_accuracy_paper",
        "robustness_accuracy_aware",
        "robustness_to_best_paper",
        "robustness_to_best_aware",
    }
    page = (out / "one" / "index.html").read_text(encoding="utf-8")
    assert "Trained in one world, judged in another" in page
    assert "training order: not re-homed" in page
