"""Any policy takes over from any other, in the middle of a trial, as often as one likes."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import Trial
from nodes.policy import PolicyNode
from nodes.policy_auto import Auto
from nodes.policy_emg import Emg
from nodes.policy_fixed import Fixed
from nodes.policy_information import Information
from nodes.policy_markov import Markov
from nodes.policy_uniform import Uniform
from palp_core import Bench

POLICIES: list[type[PolicyNode]] = [Fixed, Markov, Uniform, Information, Emg, Auto]
RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])
DEPTHS_M = np.array([0.002, 0.004, 0.008])
LEARNT = PrimitivesLearnt(
    stamp_ns=0,
    depths_m=DEPTHS_M,
    rings_m=RINGS_M,
    mean_n_m=(np.array([1.5, 1.4, 1.3])[:, None] * RINGS_M).ravel(),
    sd_n_m=np.full(15, 2.4e-4),
    count=np.full(15, 25.0),
    floor_n_m=4.5e-6,
)


def _trial(number: int) -> Trial:
    return Trial(
        stamp_ns=0, trial=number, number=1, phase="estimation", code="", label_known=False, depth_m=0.0
    )


def _belief(number: int, iteration: int) -> Belief:
    return Belief(
        stamp_ns=0, trial=number, iteration=iteration, depths_m=DEPTHS_M, posterior=np.array([0.5, 0.4, 0.1]),
        gain=np.zeros(3), gamma=0.0, gamma_defined=False, verdict="continue", estimate_m=0.002,
        confidence=0.5, outlier=False, reading_n_m=1.45 * 0.016,
    )  # fmt: skip


def _begun(policy: type[PolicyNode]) -> Bench[Any]:
    bench: Bench[Any] = Bench(policy, {}, seed=3)
    bench.feed(PolicyNode.primitives, LEARNT)
    bench.feed(PolicyNode.trial, _trial(7))
    return bench


@pytest.mark.parametrize(("old", "new"), list(itertools.permutations(POLICIES, 2)))
def test_the_trial_under_way_goes_on(old: type[PolicyNode], new: type[PolicyNode], successor: Any) -> None:
    first = _begun(old)
    ring_m = first.node.state.ring_m
    second = successor(first, new)
    assert second.node.state.trial == 7
    assert second.node.state.iteration == 1
    assert second.node.state.ring_m == ring_m
    second.feed(PolicyNode.belief, _belief(7, 1))
    command = second.sent(new.command)[-1]  # one that lands anew is re-homed first
    assert (command.trial, command.iteration) == (7, 2)
    assert min(abs(RINGS_M - command.ring_m)) < 1e-9


def test_the_same_policy_goes_on_as_if_nothing_had_been(successor: Any) -> None:
    for policy in POLICIES:
        straight, swapped = _begun(policy), _begun(policy)
        for iteration in range(1, 5):
            swapped = successor(swapped)
            for bench in (straight, swapped):
                bench.feed(PolicyNode.belief, _belief(7, iteration))
            assert swapped.sent(policy.command)[-1] == straight.sent(policy.command)[-1]


@settings(deadline=None, max_examples=8)
@given(st.lists(st.sampled_from(POLICIES), min_size=1, max_size=6))
def test_any_sequence_of_policies_keeps_count(sequence: list[type[PolicyNode]]) -> None:
    from tests.nodes.conftest import replace

    bench = _begun(sequence[0])
    for iteration, policy in enumerate(sequence, start=1):
        bench = replace(bench, policy)
        bench.feed(PolicyNode.belief, _belief(7, iteration))
        assert bench.node.state.iteration == iteration + 1


def test_who_takes_over_says_from_which_palpation_on_it_chooses_and_says_it_once(successor: Any) -> None:
    first = _begun(Fixed)
    assert first.sent(Fixed.change) == []
    second = successor(first, Uniform)
    assert second.sent(Uniform.change) == []  # it has chosen nothing yet
    for iteration in (1, 2):
        second.feed(PolicyNode.belief, _belief(7, iteration))
    (said,) = second.sent(Uniform.change)
    assert (said.trial, said.iteration, said.policy) == (7, 2, "uniform")
    same = successor(second)
    same.feed(PolicyNode.belief, _belief(7, 3))
    assert same.sent(Uniform.change) == []


def test_who_takes_over_before_the_first_trial_says_so_at_its_first_palpation(successor: Any) -> None:
    bench = successor(Bench(Fixed, {}, seed=3), Uniform)
    bench.feed(PolicyNode.primitives, LEARNT)
    bench.feed(PolicyNode.trial, _trial(7))
    (said,) = bench.sent(Uniform.change)
    assert (said.trial, said.iteration, said.policy) == (7, 1, "uniform")
