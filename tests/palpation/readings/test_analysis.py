"""Readings of a known truth: as right and as sure as exact Bayes; no trial is judged by what it taught."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import MethodError, PerceptionError
from palp_core.palpation.readings.analysis import Analysis, Plan, analyse
from palp_core.palpation.readings.readings import Readings
from palp_core.palpation.readings.training import training
from tests.support.made_up_readings import ACTIONS, MATERIALS, MadeUp, made_up

ALL_READ = Plan(stops=("fixed_number",), stop_value=4.0, fold_count=6)


@pytest.fixture(scope="module")
def many() -> MadeUp:
    """As many trials as leave little to learn: 150 a material, four readings each."""
    return made_up(150, 2)


@pytest.fixture(scope="module")
def found(many: MadeUp) -> Analysis:
    return analyse(many.readings(), ALL_READ)


def stated(found: Analysis) -> tuple[np.ndarray, np.ndarray]:
    """Return posteriors and whether each was right, in the order of the trials' numbers."""
    trials = sorted(
        found.results[0].trials, key=lambda one: int(found.training.readings.trials[one.trial.trial_index])
    )
    return np.array([one.posterior for one in trials]), np.array([one.right for one in trials])


def test_trials_are_decided_as_exact_bayes_decides_them(many: MadeUp, found: Analysis) -> None:
    """Laws learnt from 250 readings a cell against the true ones: 94 % alike, 78.4 against 78.7 % right."""
    truth, exact = many.exact()
    posterior, right = stated(found)
    assert np.mean(posterior.argmax(axis=1) == exact.argmax(axis=1)) >= 0.915
    assert np.abs(posterior - exact).mean() <= 0.044
    assert abs(right.mean() - np.mean(exact.argmax(axis=1) == truth)) <= 0.012


def test_confidence_is_deserved_where_there_is_much_to_learn_from(many: MadeUp, found: Analysis) -> None:
    (line,) = found.record["results"]
    low, high = line["calibration_error"]["ci"]
    assert low <= line["calibration_error"]["value"] <= high <= 0.12
    assert abs(line["overconfidence"]) < 0.04
    assert sum(b["accuracy"]["of"] for b in line["reliability"]) == line["trials"] == 450


def test_a_diagonal_covariance_of_correlated_columns_is_less_right(many: MadeUp, found: Analysis) -> None:
    worse = analyse(many.readings(), replace(ALL_READ, covariance="diagonal")).record["results"][0]
    assert worse["accuracy"]["value"] < found.record["results"][0]["accuracy"]["value"]


def test_student_s_t_deserves_its_confidence_more_where_cells_are_poor() -> None:
    """Twenty experiments of four trials a material: what both state, and how often they are right."""
    over = {"normal": 0.0, "student_t": 0.0}
    for seed in range(20):
        poor = made_up(4, 2, seed=seed).readings(columns=1)
        plan = replace(ALL_READ, likelihoods=tuple(over), fold_count=0)
        for line in analyse(poor, plan).record["results"]:
            over[line["likelihood"]] += line["overconfidence"] / 20
    assert over["student_t"] < over["normal"] - 0.02


def test_poor_cells_get_student_s_t_and_rich_ones_the_normal(found: Analysis) -> None:
    (rich,) = found.record["training"]["likelihoods"]
    assert rich["used"] == "normal"
    poor = analyse(made_up(4, 2).readings()).record
    (told,) = poor["training"]["likelihoods"]
    assert (told["used"], poor["training"]["least_readings_of_a_cell"]) == ("student_t", 6)
    assert poor["training"]["covariance"] == "diagonal"
    assert "6 readings" in poor["training"]["covariance_why"]


def test_no_trial_is_judged_by_what_it_taught(many: MadeUp) -> None:
    """Whatever a trial says, it is judged by the same primitives; every trial is judged once."""
    of = made_up(5, 1).readings()
    changed = replace(of, values=np.where((of.trial_index == 3)[:, None], 1e3, of.values))
    before, after = (list(training(one).learnt()) for one in (of, changed))
    assert sorted(t for fold in before for t in fold.judged) == list(range(15))
    for one, two in zip(before, after, strict=True):
        assert np.array_equal(one.primitives.mean, two.primitives.mean) == (3 in one.judged)


def test_parts_hold_each_class_evenly() -> None:
    of = made_up(8, 1).readings()
    how = training(of, fold_count=4)
    classes = [sorted(of.class_index[np.isin(of.trial_index, part)].tolist()) for part in how.folds]
    assert classes == [[0] * 4 + [1] * 4 + [2] * 4] * 4
    assert how.least == 6


def test_a_trial_s_name_that_classes_share_is_kept_out_of_training_whole() -> None:
    of = made_up(6, 1)
    shared = Readings.of(of.values, of.materials, settings=of.actions, trials=of.trials % 6)
    found = analyse(shared)
    assert found.record["trials"] == found.record["results"][0]["trials"] == 18
    assert found.record["training"]["least_readings_of_a_cell"] == 5
    assert any("several classes" in one for one in found.record["notes"])


def test_gain_asks_for_what_tells_and_uniform_for_anything() -> None:
    """One action tells all, the other nothing."""
    of = made_up(30, 3, apart=0.0)
    telling = of.values + 6.0 * np.array([[1.0, 0.0]]) * ((of.actions == 1) * of.materials)[:, None]
    readings = replace(of, values=telling).readings()
    plan = Plan(policies=("information_gain", "uniform", "fixed", "recorded"), fold_count=5)
    lines = {line["policy"]: line for line in analyse(readings, plan).record["results"]}
    assert set(lines) == {"information_gain", "uniform", "recorded", "fixed: press", "fixed: slide"}
    assert lines["information_gain"]["accuracy"]["value"] > 0.97
    assert lines["information_gain"]["readings_a_trial"] < lines["uniform"]["readings_a_trial"] - 0.3
    assert lines["recorded"]["readings_a_trial"] > 1.9  # a press comes first in each
    assert lines["fixed: slide"]["accuracy"]["value"] > 0.97
    assert lines["fixed: press"]["accuracy"]["ci"][0] < 0.5
    assert lines["fixed: press"]["ran_out"] > 80


def test_the_same_seed_gives_the_same_record() -> None:
    plan = Plan(policies=("uniform",), fold_count=3)
    of = made_up(6, 2).readings()
    assert analyse(of, plan).record == analyse(of, plan).record
    first, other = (analyse(of, replace(plan, seed=seed)).results[0].trials for seed in (1, 2))
    assert {one.trial.trial_index: one.rows for one in first} != {
        one.trial.trial_index: one.rows for one in other
    }


def test_a_setting_that_a_class_never_felt_is_left_out_and_said() -> None:
    of = made_up(8, 2)
    kept = ~((of.materials == 2) & (of.actions == 1))
    some = MadeUp(of.values[kept], of.materials[kept], of.actions[kept], of.trials[kept], of.mean, of.cov)
    found = analyse(some.readings())
    assert found.record["settings"] == ["press"]
    assert found.record["trials"] == 24
    assert any("slide (wool)" in note for note in found.record["notes"])
    only = (of.actions == 0) == (of.materials == 0)
    with pytest.raises(
        PerceptionError, match=r"no reading can be compared.*press \(silk, wool\); slide \(felt\)"
    ):
        analyse(
            Readings.of(
                of.values[only],
                [MATERIALS[c] for c in of.materials[only]],
                settings=[ACTIONS[k] for k in of.actions[only]],
            )
        )


def test_too_few_readings_say_which_cell_and_what_to_do() -> None:
    one_each = made_up(1, 1)
    with pytest.raises(
        PerceptionError, match=r"'felt' at setting 'press' has 1 reading, of which 0 are left"
    ):
        analyse(one_each.readings())
    with pytest.raises(PerceptionError, match="readings in more trials"):
        analyse(made_up(2, 1).readings())
    with pytest.raises(PerceptionError, match="cannot be judged in 99 parts"):
        analyse(made_up(4, 1).readings(), Plan(fold_count=99))
    with pytest.raises(PerceptionError, match="needs 3 readings in every cell, and one has 2"):
        analyse(made_up(3, 1).readings(), Plan(covariance="full"))


def test_methods_that_there_are_not_are_named() -> None:
    of = made_up(4, 1).readings()
    with pytest.raises(PerceptionError, match="recorded, fixed, uniform, information_gain"):
        Plan(policies=("human",))
    with pytest.raises(MethodError, match="student_t"):
        analyse(of, Plan(likelihoods=("guess",)))
    with pytest.raises(MethodError, match="posterior_threshold"):
        analyse(of, Plan(stops=("never",)))
    two = Readings.of(of.values[of.class_index < 2], of.class_index[of.class_index < 2])
    with pytest.raises(PerceptionError, match="2 classes"):
        analyse(two, Plan(stops=("paper",)))
