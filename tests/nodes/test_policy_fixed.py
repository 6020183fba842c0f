"""The fixed policy, and what it has in common with every other: when it speaks and who may follow it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from msgs.estimation import Belief
from msgs.experiment import Trial
from nodes.policy import PolicyNode
from nodes.policy_fixed import Fixed
from nodes.policy_markov import Markov
from nodes.policy_uniform import Uniform
from palp_core import Bench
from palp_core.palpation.perception.strategy import figure5

ALL: list[type[PolicyNode]] = [Fixed, Markov, Uniform]


def trial(number: int, phase: str = "estimation") -> Trial:
    return Trial(stamp_ns=0, trial=number, phase=phase, code="", label_known=phase == "training", depth_m=0.0)


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
