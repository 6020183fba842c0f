"""Every policy on the simulated rig: invariants that hold whatever the paper found."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.perception.belief.stopping import FixedNumber, PosteriorThreshold, StopRule
from palp_core.palpation.studies.paper.cases import NONE, paper_case, why_case, why_cells
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import FIXED, POLICIES, Case, Scheme, run_session
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.summary import joined, summarise
from palp_core.palpation.studies.training import begin_trained, best_ring
from palp_core.palpation.studies.trials import Outcomes

STEADY = replace(NONE, trials=40)


def ended(
    conditions: Conditions, seed: tuple[int, ...], *policies: str, stop: StopRule | None = None, **how: str
) -> dict[str, Outcomes]:
    """Return how a session's trials end under some policies, by the paper's rule or another."""
    rule = {} if stop is None else {"stop": stop}
    schemes = tuple(Scheme(name, name, **rule, **how) for name in policies)  # type: ignore[arg-type]
    case = Case("", WorldPlan(gel=Gel(), conditions=conditions), schemes)
    return {name: run.ended for name, run in run_session(case, seed).items()}


@pytest.fixture(scope="module")
def sessions() -> list[dict[str, Outcomes]]:
    plan = WorldPlan(gel=Gel(), conditions=Conditions(trials=40))
    case = paper_case(plan)
    few = replace(case, schemes=tuple(s for s in case.schemes if s.name in (*FIXED, "fixed_best")))
    found = [run_session(case if number == 0 else few, (3, number)) for number in range(8)]
    return [{name: run.ended for name, run in one.items()} for one in found]


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_decides_every_trial(name: str, sessions: list[dict[str, Outcomes]]) -> None:
    found = sessions[0][name]
    assert found.correct.shape == (120,)
    assert ((found.confidence >= 1 / 3 - 1e-9) & (found.confidence <= 1 + 1e-9)).all()
    assert (found.probes <= 15).all()
    if name not in ("chance", "best_single_probe"):
        assert (found.probes >= 2).all()
        assert (found.seconds >= 8.0 * found.probes).all()
    assert (found.right[:, -1] == found.correct).all()


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"policy": "best"}, "there is no policy 'best'; there are chance"),
        ({"policy": "markov_best"}, "there is no policy 'markov_best'"),
        ({"policy": "uniform", "filter": "kalman"}, "no method 'kalman' for task 'filter'"),
        ({"policy": "fixed_5"}, r"rings \(0.005,\)"),
        ({"policy": "uniform", "reading": "sum"}, "no feature 'sum'; there are peak, contrast"),
        ({"policy": "chance", "reading": "trace"}, "there is no policy 'chance' by the trace"),
    ],
)
def test_a_scheme_that_cannot_be_is_refused_with_those_there_are(how: dict[str, str], words: str) -> None:
    few = Gel(depths_m=(0.008,), rings_m=(0.016,)) if how.get("reading") == "trace" else Gel()
    case = Case("", WorldPlan(gel=few, conditions=Conditions(training=2, trials=1)), (Scheme("", **how),))  # type: ignore[arg-type]
    with pytest.raises(PalpError, match=words):
        run_session(case, (3, 0))


def test_the_slack_joint_is_at_chance_and_the_best_position_beats_the_average(
    sessions: list[dict[str, Outcomes]],
) -> None:
    by_name = {name: [one[name] for one in sessions] for name in sessions[1]}
    lines = {name: summarise(found, Gel().depths_m) for name, found in by_name.items()}
    assert lines["fixed_0"]["ci"][0] <= 0.4
    assert lines["fixed_0"]["accuracy"] == pytest.approx(1 / 3, abs=0.08)
    average = summarise(joined({name: by_name[name] for name in FIXED}), Gel().depths_m)
    assert lines["fixed_best"]["accuracy"] >= average["accuracy"]


def test_the_best_position_is_found_within_training() -> None:
    assert begin_trained(WorldPlan(gel=Gel()), (3, 0)).best_ring_m in (0.012, 0.016)
    alike = np.zeros((3, 2, 10))
    alike[:, 1] += np.arange(3)[:, None] + 0.01 * np.random.default_rng(0).standard_normal((3, 10))
    alike[:, 0] += np.random.default_rng(1).standard_normal((3, 10))
    assert best_ring(alike) == 1


def test_without_shared_errors_every_stiff_position_is_right() -> None:
    found = [ended(STEADY, (4, n), *FIXED[1:]) for n in range(4)]
    for name in FIXED[1:]:
        assert np.mean([one[name].correct.mean() for one in found]) >= 0.99


def test_policies_meet_the_same_trials(sessions: list[dict[str, Outcomes]]) -> None:
    single = ended(Conditions(trials=40), (3, 0), "fixed_16", stop=FixedNumber(1))["fixed_16"]
    assert (single.right[:, 0] == sessions[0]["fixed_16"].right[:, 0]).all()


def test_a_gain_policy_knows_what_a_naive_filter_does_not() -> None:
    """Height unknown: the filter that knows it is right more often, and knows how often."""
    unknown, stop = Conditions(height_sd_m=0.2e-3, mounting="each_trial", trials=60), PosteriorThreshold()
    naive, latent = (
        summarise(
            [ended(unknown, (6, n), name, stop=stop, filter=known)[name] for n in range(4)], Gel().depths_m
        )
        for name, known in (("information_gain", "naive"), ("information_gain_latent", "latent"))
    )
    assert latent["accuracy"] > naive["accuracy"]
    assert latent["ece"] < 0.5 * naive["ece"]


def test_one_reading_used_again_makes_no_progress() -> None:
    frozen = Conditions(trials=40, same_reading=True)
    found = ended(frozen, (7, 0), "fixed_12", stop=FixedNumber(10))["fixed_12"]
    assert (found.right[:, 0] == found.right[:, -1]).mean() > 0.98


def test_only_a_ring_that_never_moves_keeps_its_landing_from_trial_to_trial() -> None:
    """Without re-homing, trials of a fixed ring are right or wrong together."""
    alike, moving = [], []
    for rehome in (True, False):
        steady = Conditions(height_sd_m=0.0, trials=40, rehome=rehome)
        found = [ended(steady, (9, n), "fixed_4", stop=FixedNumber(1))["fixed_4"] for n in range(4)]
        shares = np.array([one.correct.reshape(3, 40).mean(axis=1) for one in found])
        alike.append(float(np.mean(np.maximum(shares, 1.0 - shares))))
        moving.append(ended(steady, (9, 0), "uniform_stiff")["uniform_stiff"].confidence)
    assert alike[0] < 0.9 < alike[1]
    assert np.array_equal(moving[0], moving[1])


def test_conditions_that_cannot_be_are_refused() -> None:
    with pytest.raises(PalpError, match="no distribution 'none'; use one of uniform, normal"):
        Conditions(distribution="none")
    with pytest.raises(PalpError, match="phantoms per depth"):
        Conditions(phantoms=0)
    with pytest.raises(PalpError, match="training needs 2"):
        Conditions(training=1)


def test_a_hypothesis_that_is_left_out_is_gone() -> None:
    """H2 has the ring's error of H1 in it: all but H1 was the same run as all."""
    cells = why_cells()
    whole = why_case("all", cells["all"], 40)
    for name in cells["all"]:
        assert cells[f"only {name}"] == (name,)
        assert name not in cells[f"all but {name}"]
        without = why_case("all", cells[f"all but {name}"], 40)
        assert (without.plan, without.schemes) != (whole.plan, whole.schemes)
    assert why_case("", cells["all but H1"], 40).plan.conditions.repeatability_m == 0.0
    assert why_case("", (), 40).plan.conditions == STEADY
