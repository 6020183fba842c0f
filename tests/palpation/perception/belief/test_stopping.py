from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import correlation

from nodes.estimator import Estimator, EstimatorParams
from palp_core.errors import MethodError, PerceptionError
from palp_core.graph.node.params import describe_params
from palp_core.methods import Method, methods, register
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.stopping import (
    BeliefStep,
    FixedNumber,
    PaperGuarded,
    PaperVerbatim,
    PosteriorThreshold,
    StopRule,
    StopState,
    correlation_distance,
    decide,
    require_classes,
    stop_rule,
)
from palp_core.palpation.session.reanalysis import Methods as DecisionMethods

FLAT = np.full(3, 1 / 3)
PAPER: list[StopRule] = [PaperVerbatim(), PaperGuarded()]


def _history(*beliefs: list[float]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    posteriors = [np.array(b) for b in beliefs]
    return posteriors, [gain_vector(p, np.full(len(p), 1 / len(p))) for p in posteriors]


def _after(*beliefs: list[float]) -> BeliefStep:
    return BeliefStep.last(*_history(*beliefs))


@pytest.mark.parametrize("rule", PAPER)
def test_one_probe_never_stops_where_the_published_loop_does(rule: StopRule) -> None:
    posteriors, gains = _history([0.7, 0.2, 0.1])
    with np.errstate(all="ignore"):
        gamma = 1.0 - np.corrcoef(np.zeros(3), gains[0])[0, 1]
    goes_on = gamma > 0.0005
    assert not goes_on
    state = rule.check(BeliefStep.last(posteriors, gains))
    assert np.isnan(state.gamma)
    assert not state.converged


@pytest.mark.parametrize("rule", PAPER)
def test_equal_one_hot_posteriors_stop(rule: StopRule) -> None:
    state = rule.check(_after([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]))
    assert state.gamma == pytest.approx(0.0, abs=1e-12)
    assert state.converged


@pytest.mark.parametrize("rule", PAPER)
@pytest.mark.parametrize("rounding", [0.0, 1e-16])
def test_uninformative_probes_never_stop(rule: StopRule, rounding: float) -> None:
    nothing = [1 / 3 + rounding, 1 / 3 - rounding, 1 / 3]
    for history in (
        _after(nothing, nothing),
        _after([0.7, 0.2, 0.1], nothing),
        _after(nothing, [0.7, 0.2, 0.1]),
    ):
        state = rule.check(history)
        assert np.isnan(state.gamma)
        assert not state.converged


@pytest.mark.parametrize("rule", PAPER)
def test_two_depths_are_refused_and_the_alternatives_named(rule: StopRule) -> None:
    posteriors, gains = _history([0.7, 0.3], [0.6, 0.4])
    assert correlation(gains[0], gains[1]) == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(PerceptionError, match="posterior_threshold"):
        rule.check(BeliefStep.last(posteriors, gains))


def test_a_doubled_belief_fools_the_verbatim_rule_and_not_the_guarded_one() -> None:
    history = _after([0.4, 0.3, 0.3], [0.9, 0.05, 0.05])
    assert PaperVerbatim().check(history).gamma == pytest.approx(0.0, abs=1e-12)
    assert PaperVerbatim().check(history).converged
    assert not PaperGuarded().check(history).converged


def test_a_settled_belief_stops_the_guarded_rule() -> None:
    assert PaperGuarded().check(_after([0.9, 0.05, 0.05], [0.91, 0.045, 0.045])).converged


def test_a_belief_that_moves_to_another_class_stops_no_paper_rule() -> None:
    history = _after([0.8, 0.1, 0.1], [0.1, 0.8, 0.1])
    assert not any(rule.check(history).converged for rule in PAPER)


def test_a_posterior_threshold_works_for_two_depths() -> None:
    assert not PosteriorThreshold(0.95).check(_after([0.7, 0.3])).converged
    assert PosteriorThreshold(0.95).check(_after([0.96, 0.04])).converged


def test_a_fixed_number_stops_at_that_number() -> None:
    history = _after([0.7, 0.3], [0.6, 0.4])
    assert FixedNumber(2).check(history).converged
    assert not FixedNumber(3).check(history).converged


def test_rules_are_found_by_name() -> None:
    assert stop_rule("paper_guarded", 0.1) == PaperGuarded(threshold=0.1)
    assert {m.name for m in methods("stop")} == {
        "paper",
        "paper_guarded",
        "posterior_threshold",
        "fixed_number",
    }
    with pytest.raises(MethodError, match="paper"):
        stop_rule("wald")


vectors = st.integers(0, 100_000).map(lambda seed: np.random.default_rng(seed).normal(size=(2, 5)))


@settings(deadline=None, max_examples=40)
@given(vectors, st.floats(0.01, 100.0), st.floats(-10.0, 10.0))
def test_the_distance_is_scipys_and_blind_to_scale_and_shift(
    pair: np.ndarray, scale: float, shift: float
) -> None:
    distance = correlation_distance(pair[0], pair[1])
    assert distance == pytest.approx(correlation(pair[0], pair[1]), abs=1e-12)
    assert correlation_distance(scale * pair[0] + shift, pair[1]) == pytest.approx(distance, abs=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 100_000))
def test_relabelling_the_depths_changes_no_verdict(seed: int) -> None:
    rng = np.random.default_rng(seed)
    beliefs = rng.dirichlet(np.ones(4), size=3)
    order = rng.permutation(4)
    rules: list[StopRule] = [*PAPER, PosteriorThreshold(0.6)]
    for rule in rules:
        here = decide(rule, *_history(*beliefs.tolist()), max_probes=9)
        there = decide(rule, *_history(*beliefs[:, order].tolist()), max_probes=9)
        assert here.word == there.word
        assert order[there.class_index] == here.class_index


@pytest.mark.parametrize(
    ("name", "value", "max_probes"),
    [("fixed_number", 20, 15), ("fixed_number", 0, 4), ("paper_guarded", 0, 0)],
)
def test_a_rule_that_never_gets_its_probes_is_refused(name: str, value: float, max_probes: int) -> None:
    with pytest.raises(PerceptionError, match=f"max_probes is {max_probes}"):
        stop_rule(name, value, max_probes=max_probes)
    assert stop_rule("fixed_number", 15, max_probes=15) == FixedNumber(15)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0])
@pytest.mark.parametrize("name", ["paper", "paper_guarded", "posterior_threshold", "fixed_number"])
def test_a_stop_value_that_is_no_number_is_refused(name: str, value: float) -> None:
    """NaN made a rule that never stops, infinity one that always does."""
    with pytest.raises(PerceptionError, match="cannot have"):
        stop_rule(name, value)


@dataclass(frozen=True)
class AfterDoubt(StopRule):
    largest: ClassVar[float] = 1.0
    doubt: float = 0.5

    def check(self, step: BeliefStep) -> StopState:
        sure = step.posterior.max(axis=-1) > 1.0 - self.doubt
        return StopState(np.full(np.shape(sure), np.nan), np.asarray(sure))


def test_a_class_and_a_row_are_all_that_a_new_rule_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches, the estimator's choices and a re-analysis know it by its row."""
    row = Method(
        task="stop", name="after_doubt", place=f"{__name__}:AfterDoubt", cost_s=1e-6, evidence="here"
    )
    monkeypatch.setitem(register.register().methods, ("stop", "after_doubt"), row)
    assert "after_doubt" in describe_params(EstimatorParams)["stop"].choices
    assert Estimator.examine(EstimatorParams(stop="after_doubt")) == {}
    examined = Estimator.examine(EstimatorParams(stop="after_doubt", stop_value=2.0))
    assert "cannot have doubt" in examined["stop"]
    assert DecisionMethods(stop="after_doubt").stop == "after_doubt"
    require_classes("after_doubt", 2)
    history = _history([0.7, 0.2, 0.1])
    assert decide(stop_rule("after_doubt", 0.4), *history, max_probes=3).word == "decided"
    assert decide(stop_rule("after_doubt", 0.2), *history, max_probes=3).word == "continue"
    side_by_side = BeliefStep.over(FLAT, np.array([[0.7, 0.2, 0.1], FLAT]), np.array([FLAT, FLAT]), 1)
    assert stop_rule("after_doubt").check(side_by_side).converged.tolist() == [True, False]


def test_verdicts_are_continue_decided_and_undecided() -> None:
    history = _history([0.2, 0.5, 0.3], [0.2, 0.5, 0.3])
    words = [
        decide(PosteriorThreshold(0.9), *history, max_probes=3).word,
        decide(PosteriorThreshold(0.5), *history, max_probes=2).word,
        decide(PosteriorThreshold(0.9), *history, max_probes=2).word,
    ]
    assert words == ["continue", "decided", "undecided"]
    verdict = decide(PosteriorThreshold(0.9), *history, max_probes=2)
    assert (verdict.class_index, verdict.probe_count) == (1, 2)


RULES: list[StopRule] = [PaperVerbatim(0.05), PaperGuarded(0.3, 0.3), PosteriorThreshold(0.6), FixedNumber(3)]


@pytest.mark.parametrize("rule", RULES, ids=lambda r: type(r).__name__)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_a_batch_stops_where_its_trials_stop(rule: StopRule, seed: int) -> None:
    rng = np.random.default_rng(seed)
    history = [rng.dirichlet(np.full(3, 0.5), 20) for _ in range(4)]
    history[1][:5] = FLAT  # an uninformative probe has no gain
    history[2][:3] = np.eye(3)  # certainty
    history[3][:3] = np.eye(3)
    for t in range(1, 5):
        before = history[t - 2] if t > 1 else np.tile(FLAT, (20, 1))
        got = rule.check(BeliefStep.over(FLAT, history[t - 1], before, t))
        for n in range(20):
            posteriors = [p[n] for p in history[:t]]
            alone = rule.check(BeliefStep.last(posteriors, [gain_vector(p, FLAT) for p in posteriors]))
            assert got.converged[n] == alone.converged
            np.testing.assert_array_equal(got.gamma[n], alone.gamma)
