"""Every policy on the simulated rig: invariants that hold whatever the paper found."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.perception.belief.stopping import FixedNumber, PaperVerbatim, PosteriorThreshold
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import (
    NAMES,
    TrainedFeature,
    begin_trained,
    best_ring,
    run_policy,
)
from palp_core.palpation.studies.simulation.policy_summary import average_of, summarise
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trials import Outcomes

FIXED = ("fixed_0", "fixed_4", "fixed_8", "fixed_12", "fixed_16")
STEADY = Conditions(repeatability_m=0.0, height_sd_m=0.0, trials=40)


def begin_peak(conditions: Conditions, seed: tuple[int, ...]) -> TrainedFeature:
    return begin_trained(WorldPlan(gel=Gel(), conditions=conditions), seed)


@pytest.fixture(scope="module")
def sessions() -> list[TrainedFeature]:
    return [begin_peak(Conditions(trials=40), (3, number)) for number in range(8)]


def every(name: str, sessions: list[TrainedFeature], **options: str) -> list[Outcomes]:
    return [run_policy(name, one, PaperVerbatim(), **options) for one in sessions]  # type: ignore[arg-type]


@pytest.mark.parametrize("name", NAMES)
def test_every_policy_decides_every_trial(name: str, sessions: list[TrainedFeature]) -> None:
    found = run_policy(name, sessions[0], PaperVerbatim())
    assert found.correct.shape == (120,)
    assert ((found.confidence >= 1 / 3 - 1e-9) & (found.confidence <= 1 + 1e-9)).all()
    assert (found.probes <= 15).all()
    if name not in ("chance", "best_single_probe"):
        assert (found.probes >= 2).all()
        assert (found.seconds >= 8.0 * found.probes).all()
    assert (found.right[:, -1] == found.correct).all()


def test_a_name_that_is_none_is_refused_with_those_there_are(sessions: list[TrainedFeature]) -> None:
    with pytest.raises(PalpError, match="there is no policy 'best'; there are chance"):
        run_policy("best", sessions[0], PaperVerbatim())
    with pytest.raises(PalpError, match="no method 'kalman' for task 'filter'"):
        run_policy("uniform", sessions[0], PaperVerbatim(), filter_name="kalman")
    with pytest.raises(PalpError, match=r"rings \(0.005,\)"):
        run_policy("fixed_5", sessions[0], PaperVerbatim())


def test_a_slack_joint_is_at_chance(sessions: list[TrainedFeature]) -> None:
    line = summarise(every("fixed_0", sessions), Gel().depths_m)
    assert line["ci"][0] <= 0.4
    assert line["accuracy"] == pytest.approx(1 / 3, abs=0.08)


@pytest.mark.parametrize("name", FIXED[1:])
def test_without_shared_errors_every_stiff_position_is_right(name: str) -> None:
    found = [run_policy(name, begin_peak(STEADY, (4, n)), PaperVerbatim()) for n in range(4)]
    assert np.mean([one.correct.mean() for one in found]) >= 0.99


def test_the_best_fixed_position_is_no_worse_than_their_average(sessions: list[TrainedFeature]) -> None:
    average = average_of({name: every(name, sessions) for name in FIXED}, Gel().depths_m)
    best = summarise(every("fixed_best", sessions), Gel().depths_m)
    assert best["accuracy"] >= average["accuracy"]


def test_intervals_shrink_with_sessions() -> None:
    found = [
        run_policy("fixed_8", begin_peak(Conditions(trials=20), (5, n)), PaperVerbatim()) for n in range(24)
    ]
    few, many = (summarise(found[:n], Gel().depths_m)["ci"] for n in (4, 24))
    assert many[1] - many[0] < few[1] - few[0]


def test_the_best_position_is_found_within_training(sessions: list[TrainedFeature]) -> None:
    assert {one.best_ring_m for one in sessions} <= {0.012, 0.016}
    alike = np.zeros((3, 2, 10))
    alike[:, 1] += np.arange(3)[:, None] + 0.01 * np.random.default_rng(0).standard_normal((3, 10))
    alike[:, 0] += np.random.default_rng(1).standard_normal((3, 10))
    assert best_ring(alike) == 1


def test_policies_meet_the_same_luck(sessions: list[TrainedFeature]) -> None:
    again = run_policy("fixed_16", sessions[0], PaperVerbatim())
    first = run_policy("fixed_16", sessions[0], PaperVerbatim())
    assert (again.estimate == first.estimate).all()
    single = run_policy("fixed_16", sessions[0], FixedNumber(1))
    assert (single.right[:, 0] == first.right[:, 0]).all()


def test_a_gain_policy_knows_what_a_naive_filter_does_not() -> None:
    """Height unknown: the filter that knows it is right more often, and knows how often."""
    unknown = Conditions(height_sd_m=0.2e-3, mounting="each_trial", trials=60)
    stop, found = PosteriorThreshold(), {}
    for name, filter_name in (("information_gain", "naive"), ("information_gain_latent", "latent")):
        found[filter_name] = summarise(
            [run_policy(name, begin_peak(unknown, (6, n)), stop, filter_name=filter_name) for n in range(4)],
            Gel().depths_m,
        )
    assert found["latent"]["accuracy"] > found["naive"]["accuracy"]
    assert found["latent"]["ece"] < 0.5 * found["naive"]["ece"]


def test_one_reading_used_again_makes_no_progress() -> None:
    frozen = begin_peak(replace(Conditions(trials=40), same_reading=True), (7, 0))
    found = run_policy("fixed_12", frozen, FixedNumber(10))
    assert (found.right[:, 0] == found.right[:, -1]).mean() > 0.98


def test_only_a_ring_that_never_moves_keeps_its_landing_from_trial_to_trial() -> None:
    """Without re-homing, trials of a fixed ring are right or wrong together."""
    alike = []
    for rehome in (True, False):
        steady = Conditions(height_sd_m=0.0, trials=40, rehome=rehome)
        begun = [begin_peak(steady, (9, number)) for number in range(4)]
        shares = [
            run_policy("fixed_4", one, FixedNumber(1)).correct.reshape(3, 40).mean(axis=1) for one in begun
        ]
        moving = run_policy("uniform_stiff", begun[0], PaperVerbatim())
        alike.append((float(np.mean(np.maximum(shares, 1.0 - np.array(shares)))), moving.confidence))
    (homed, first), (kept, second) = alike
    assert homed < 0.9 < kept
    assert np.array_equal(first, second)


def test_ten_thousand_trials_are_one_batch() -> None:
    many = begin_peak(Conditions(trials=3334, max_probes=5), (8, 0))
    found = run_policy("fixed_16", many, FixedNumber(5))
    assert found.correct.size == 10_002


def test_conditions_that_cannot_be_are_refused() -> None:
    with pytest.raises(PalpError, match="no distribution 'none'; use one of uniform, normal"):
        Conditions(distribution="none")
    with pytest.raises(PalpError, match="phantoms per depth"):
        Conditions(phantoms=0)
    with pytest.raises(PalpError, match="training needs 2"):
        Conditions(training=1)
