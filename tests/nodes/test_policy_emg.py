"""The EMG-driven policy: the ring goes where the person's latest burst puts it."""

from __future__ import annotations

import numpy as np

from msgs.emg import CoContraction
from msgs.estimation import Belief
from msgs.experiment import Trial
from nodes.policy_emg import Emg
from palp_core import Bench


def heard(level: int, *, defined: bool = True) -> CoContraction:
    return CoContraction(
        stamp_ns=0,
        start_ns=0,
        rate_hz=1500.0,
        reference_v=1.0,
        value=np.zeros(1),
        burst_count=1,
        level=level,
        level_defined=defined,
    )


def trial(number: int) -> Trial:
    return Trial(
        stamp_ns=0, trial=number, number=1, phase="estimation", code="", label_known=False, depth_m=0.0
    )


def belief(number: int, iteration: int) -> Belief:
    return Belief(
        stamp_ns=0,
        trial=number,
        iteration=iteration,
        depths_m=np.array([0.002, 0.004, 0.008]),
        posterior=np.full(3, 1 / 3),
        gain=np.zeros(3),
        gamma=0.0,
        gamma_defined=False,
        verdict="continue",
        estimate_m=0.002,
        confidence=1 / 3,
        outlier=False,
    )


def test_it_follows_the_latest_burst_within_a_trial() -> None:
    bench = Bench(Emg, {})
    bench.feed(Emg.trial, trial(0))
    for iteration, level in enumerate((0, 4, 3), start=1):
        bench.feed(Emg.cocontraction, heard(level))
        bench.feed(Emg.belief, belief(0, iteration))
    assert [c.ring_m for c in bench.sent(Emg.command)] == [0.008, 0.0, 0.016, 0.012]


def test_until_a_burst_it_stays_in_the_middle_and_in_a_pause_where_it_was() -> None:
    bench = Bench(Emg, {})
    bench.feed(Emg.cocontraction, heard(0, defined=False))
    bench.feed(Emg.trial, trial(0))
    bench.feed(Emg.belief, belief(0, 1))
    assert [c.ring_m for c in bench.sent(Emg.command)] == [0.008, 0.008]


def test_a_level_heard_before_the_trial_counts() -> None:
    bench = Bench(Emg, {"start_level": 0})
    bench.feed(Emg.cocontraction, heard(3))
    bench.feed(Emg.trial, trial(0))
    assert bench.sent(Emg.command)[-1].ring_m == 0.012
