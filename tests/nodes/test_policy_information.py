"""The information-gain policy: it probes where the depths differ, and lands anew when that tells more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import Trial
from nodes.policy_information import Information
from nodes.policy_uniform import Uniform
from palp_core import Bench

RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])
SLOPE_N = np.array([1.5, 1.4, 1.3])
MEAN = SLOPE_N[:, None] * RINGS_M


def learnt(noise_n_m: float = 2e-5) -> PrimitivesLearnt:
    sd = np.sqrt((1.4 * 0.17e-3) ** 2 + noise_n_m**2) * np.ones(MEAN.shape)
    return PrimitivesLearnt(
        stamp_ns=0,
        depths_m=np.array([0.002, 0.004, 0.008]),
        rings_m=RINGS_M,
        mean_n_m=MEAN.ravel(),
        sd_n_m=sd.ravel(),
        count=np.full(15, 25.0),
        floor_n_m=4.5e-6,
    )


def trial(number: int, phase: str = "estimation") -> Trial:
    return Trial(stamp_ns=0, trial=number, number=1, phase=phase, code="", label_known=False, depth_m=0.0)


def belief(number: int, iteration: int, reading_n_m: float = 1.45 * 0.016) -> Belief:
    return Belief(
        stamp_ns=0,
        trial=number,
        iteration=iteration,
        depths_m=np.array([0.002, 0.004, 0.008]),
        posterior=np.array([0.45, 0.45, 0.1]),
        gain=np.zeros(3),
        gamma=0.0,
        gamma_defined=False,
        verdict="continue",
        estimate_m=0.002,
        confidence=0.45,
        outlier=False,
        reading_n_m=reading_n_m,
    )


def informed(**params: Any) -> Bench[Information]:
    bench = Bench(Information, params)
    bench.feed(Information.primitives, learnt())
    bench.feed(Information.trial, trial(0))
    return bench


def test_it_begins_where_the_depths_differ_most() -> None:
    assert informed().sent(Information.command)[-1].ring_m == 0.016


def test_it_lands_anew_because_a_repeat_would_share_its_error() -> None:
    bench = informed(height_sd_mm=0.0)
    bench.feed(Information.belief, belief(0, 1))
    first, again, there = bench.sent(Information.command)
    assert (first.rehome, again.rehome, there.rehome) == (False, True, False)
    assert (again.iteration, there.iteration, there.ring_m) == (2, 2, 0.016)


@pytest.mark.parametrize("params", [{"ring_sd_mm": 0.0}, {"knows": "naive"}])
def test_it_stays_where_it_knows_of_nothing_that_stays(params: dict[str, Any]) -> None:
    bench = informed(**params)
    bench.feed(Information.belief, belief(0, 1))
    assert [c.rehome for c in bench.sent(Information.command)] == [False, False]


def test_before_any_training_it_probes_with_the_stiffest() -> None:
    bench = Bench(Information, {"start_mm": 12.0})
    bench.feed(Information.trial, trial(0))
    bench.feed(Information.belief, belief(0, 1))
    assert [c.ring_m for c in bench.sent(Information.command)] == [0.012, 0.012]


def test_training_is_not_its_business() -> None:
    bench = Bench(Information, {})
    bench.feed(Information.trial, trial(0, "training"))
    assert not bench.sent(Information.command)


def test_it_takes_over_what_another_policy_was_told(successor: Any) -> None:
    old = Bench(Uniform, {}, seed=3)
    old.feed(Uniform.primitives, learnt())
    old.feed(Uniform.trial, trial(0))
    new = successor(old, Information)
    begun_m = old.sent(Uniform.command)[-1].ring_m
    new.feed(Information.belief, belief(0, 1, 1.45 * begun_m))
    assert new.sent(Information.command)[-1].ring_m == 0.016
    assert new.node.state.primitives["rings_m"] == RINGS_M.tolist()
