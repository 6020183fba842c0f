"""The fixed policy, and what all have in common: when one speaks, who may follow, what it may ask for."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import Trial
from nodes.policy import ASKED_AGAIN, FIRST_CHOICES, PolicyNode
from nodes.policy_emg import Emg, EmgPolicyParams
from nodes.policy_fixed import Fixed, FixedParams
from nodes.policy_information import Information, InformationParams
from nodes.policy_markov import Markov, MarkovParams
from nodes.policy_uniform import Uniform, UniformParams
from palp_core import Bench
from palp_core.errors import GraphError, NodeError
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import RingChoice, StiffnessPolicy, everywhere

ALL: list[type[PolicyNode]] = [Fixed, Markov, Uniform]


def trial(number: int, phase: str = "estimation") -> Trial:
    return Trial(
        stamp_ns=0, trial=number, number=1, phase=phase, code="", label_known=phase == "training", depth_m=0.0
    )


def belief(number: int, iteration: int, verdict: str = "continue") -> Belief:
    return Belief(
        stamp_ns=0,
        trial=number,
        iteration=iteration,
        depths_m=np.array([0.002, 0.004, 0.008]),
        posterior=np.array([0.2, 0.5, 0.3]),
        gain=np.zeros(3),
        gamma=0.0,
        gamma_defined=False,
        verdict=verdict,
        estimate_m=0.004,
        confidence=0.5,
        outlier=False,
    )


def commanded(bench: Bench[Any]) -> list[tuple[int, int]]:
    return [(c.trial, c.iteration) for c in bench.sent(PolicyNode.command)]


def rings_m(bench: Bench[Any]) -> list[float]:
    return [c.ring_m for c in bench.sent(PolicyNode.command)]


def test_it_keeps_the_ring_where_it_was_told() -> None:
    bench = Bench(Fixed, {"ring_mm": 12.0})
    bench.feed(PolicyNode.trial, trial(0))
    bench.feed(PolicyNode.belief, belief(0, 1), belief(0, 2))
    assert rings_m(bench) == [0.012, 0.012, 0.012]


def test_a_changed_ring_position_holds_from_the_next_trial_on() -> None:
    bench = Bench(Fixed)
    bench.feed(PolicyNode.trial, trial(0))
    bench.set_parameters(ring_mm=4.0)
    bench.feed(PolicyNode.belief, belief(0, 1))
    bench.feed(PolicyNode.trial, trial(1))
    assert rings_m(bench) == [0.016, 0.016, 0.004]


@pytest.mark.parametrize("policy", ALL)
def test_no_policy_speaks_in_training(policy: type[PolicyNode]) -> None:
    bench = Bench(policy)
    bench.feed(PolicyNode.trial, trial(0, "training"))
    bench.feed(PolicyNode.belief, belief(0, 1))
    assert commanded(bench) == []


@pytest.mark.parametrize("policy", ALL)
def test_every_policy_begins_a_trial_and_goes_on_while_the_verdict_is_open(policy: type[PolicyNode]) -> None:
    bench = Bench(policy)
    bench.feed(PolicyNode.trial, trial(3))
    assert commanded(bench) == [(3, 1)]
    bench.feed(PolicyNode.belief, belief(3, 1), belief(3, 2), belief(3, 3, "decided"))
    bench.feed(PolicyNode.trial, trial(4))
    bench.feed(PolicyNode.belief, belief(4, 1, "undecided"), belief(3, 4))
    assert commanded(bench) == [(3, 1), (3, 2), (3, 3), (4, 1)]


@pytest.mark.parametrize("policy", ALL)
def test_every_policy_is_silent_on_the_clock(policy: type[PolicyNode]) -> None:
    assert Bench(policy).executor.next_due_ns() is None


@pytest.mark.parametrize("policy", [Markov, Uniform])
def test_the_same_seed_gives_the_same_commands(policy: type[PolicyNode]) -> None:
    def run(seed: int) -> list[float]:
        bench = Bench(policy, seed=seed)
        for number in range(6):
            bench.feed(PolicyNode.trial, trial(number))
            bench.feed(PolicyNode.belief, *(belief(number, i) for i in range(1, 6)))
        return rings_m(bench)

    assert run(1) == run(1) != run(2)
    assert set(run(1)) <= set(figure5.RINGS_M)


@pytest.mark.parametrize("new", ALL)
@pytest.mark.parametrize("old", ALL)
def test_any_policy_goes_on_with_the_trial_of_any_other(
    old: type[PolicyNode], new: type[PolicyNode], successor: Any
) -> None:
    first = Bench(old)
    first.feed(PolicyNode.trial, trial(7))
    first.feed(PolicyNode.belief, belief(7, 1))
    second = successor(first, new)
    second.feed(PolicyNode.belief, belief(7, 2), belief(7, 3, "decided"))
    assert commanded(first) + commanded(second) == [(7, 1), (7, 2), (7, 3)]


@pytest.mark.parametrize("policy", ALL)
def test_a_replacement_of_the_same_policy_continues_byte_for_byte(policy, successor, frames_of) -> None:  # type: ignore[no-untyped-def]
    whole, first = Bench(policy), Bench(policy)
    for bench in (whole, first):
        bench.feed(PolicyNode.trial, trial(0))
        bench.feed(PolicyNode.belief, belief(0, 1))
    second = successor(first)
    for bench in (whole, second):
        bench.feed(PolicyNode.belief, *(belief(0, i) for i in range(2, 12)))
    assert frames_of(first) + frames_of(second) == frames_of(whole)


def test_a_policy_that_chooses_nothing_cannot_be_configured() -> None:
    with pytest.raises(Exception, match=r"define choose\(\)"):
        Bench(PolicyNode)


LEARNT = PrimitivesLearnt(
    stamp_ns=0,
    depths_m=np.array([0.002, 0.004, 0.008]),
    rings_m=np.array(figure5.RINGS_M),
    mean_n_m=np.linspace(0.0, 1.0, 15),
    sd_n_m=np.full(15, 2.4e-4),
    count=np.full(15, 25.0),
    floor_n_m=4.5e-6,
)


@dataclasses.dataclass
class Script:
    """Asks for positions in turn, and for the last one ever after."""

    rings_m: tuple[float, ...]
    asked: int = 0

    def start(self, uniform: Any, trial_count: int | None = None) -> RingChoice:
        self.asked += 1
        return everywhere(min(self.asked, len(self.rings_m)) - 1, trial_count)

    def step(self, at: RingChoice, belief: Any, uniform: Any) -> RingChoice:
        return self.start(uniform)


class Scripted(PolicyNode):
    rings_m: tuple[float, ...] = ()

    def choose(self) -> StiffnessPolicy:
        return Script(self.rings_m)


def scripted(*asked_m: float) -> Bench[Any]:
    bench: Bench[Any] = Bench(type("Scripted", (Scripted,), {"rings_m": asked_m, "__module__": __name__}))
    bench.feed(PolicyNode.primitives, LEARNT)
    bench.feed(PolicyNode.trial, trial(0))
    return bench


def test_a_policy_that_asks_for_an_untrained_position_is_asked_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = scripted(0.013, 0.9, 0.008)
    assert rings_m(bench) == [0.008]
    assert "ring position 13 mm is not trained; trained are 0, 4, 8, 12, 16 mm; the policy is" in caplog.text
    bench.feed(PolicyNode.belief, belief(0, 1))
    assert rings_m(bench) == [0.008, 0.008]
    assert len(caplog.records) == 2


@pytest.mark.parametrize(
    ("asked_m", "sent_m"), [(0.013, 0.013), (0.9, 0.049), (-1.0, 0.0), (math.nan, 0.049)]
)
def test_one_that_later_insists_gets_a_position_in_reach_that_ends_its_trial(
    asked_m: float, sent_m: float, caplog: pytest.LogCaptureFixture
) -> None:
    bench = scripted(*[0.008] * FIRST_CHOICES, asked_m)
    bench.feed(PolicyNode.belief, *(belief(0, number + 1) for number in range(FIRST_CHOICES)))
    assert rings_m(bench) == [*[0.008] * FIRST_CHOICES, sent_m]
    assert len(caplog.records) == ASKED_AGAIN


@pytest.mark.parametrize("good", range(FIRST_CHOICES))
def test_one_that_insists_in_its_first_choices_fails_by_name(good: int) -> None:
    bench: Bench[Any] = Bench(type("Odd", (Scripted,), {"rings_m": (*[0.008] * good, 0.017)}))
    bench.feed(PolicyNode.primitives, LEARNT)

    def palpate() -> None:
        bench.feed(PolicyNode.trial, trial(0))
        bench.feed(PolicyNode.belief, *(belief(0, number + 1) for number in range(good)))

    words = "17 mm is not trained; trained are 0, 4, 8, 12, 16 mm, and Odd insists on it; let it choose"
    with pytest.raises(NodeError, match=words):
        palpate()
    assert rings_m(bench) == [0.008] * good


def test_a_parameter_that_is_not_trained_is_refused_and_nothing_changes() -> None:
    bench: Bench[Any] = Bench(Fixed)
    with pytest.raises(GraphError, match="ring_mm: ring position 13 mm is not trained; trained are 0, 4, 8"):
        bench.set_parameters(ring_mm=13.0)
    bench.feed(PolicyNode.trial, trial(0))
    assert rings_m(bench) == [0.016]


def test_what_was_trained_counts_and_not_what_was_announced() -> None:
    bench: Bench[Any] = Bench(Fixed, {"trained_mm": "0, 4, 8, 12, 13, 16"})
    bench.set_parameters(ring_mm=13.0)
    bench.set_parameters(ring_mm=16.0)
    bench.feed(PolicyNode.primitives, LEARNT)
    with pytest.raises(GraphError, match="13 mm is not trained"):
        bench.set_parameters(ring_mm=13.0)


@pytest.mark.parametrize(
    ("policy", "params", "guilty"),
    [
        (Fixed, FixedParams(ring_mm=20.0), ["ring_mm"]),
        (Fixed, FixedParams(ring_mm=20.0, trained_mm="0 20"), []),
        (Uniform, UniformParams(rings_mm=(4.0, 5.0)), ["rings_mm"]),
        (Markov, MarkovParams(), []),
        (Markov, MarkovParams(trained_mm="0, 16"), [""]),
        (Emg, EmgPolicyParams(trained_mm="0, 16"), [""]),
        (Emg, EmgPolicyParams(start_level=5), ["start_level"]),
        (Information, InformationParams(trained_mm="0, 16"), []),
        (Fixed, FixedParams(trained_mm="sixteen"), ["trained_mm"]),
        (Fixed, FixedParams(trained_mm="99"), ["trained_mm"]),
        (Fixed, FixedParams(trained_mm=""), ["trained_mm"]),
    ],
)
def test_the_check_names_the_parameter(policy: type[PolicyNode], params: Any, guilty: list[str]) -> None:
    assert list(policy.examine(params)) == guilty
