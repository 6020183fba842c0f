"""Trials whose sweeps are chosen: right, faster than with the ring alone, on equal luck."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.palpation.studies.frontier.action_trials import (
    action_set,
    offer,
    run_action_trials,
    time_of,
)
from palp_core.palpation.studies.frontier.protocols import SWIFT
from palp_core.palpation.studies.frontier.trace_trials import (
    MostBits,
    model_of,
    run_trace_trials,
    settings_of,
)
from palp_core.palpation.studies.frontier.world_session import WorldPlan, WorldSession, begin
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.reading_table import Gel
from palp_core.palpation.world.model import LAB

RINGS = Gel(depths_m=(0.002, 0.008), rings_m=(0.004, 0.016))
PLAN = WorldPlan(
    world=LAB,
    conditions=Conditions(
        training=25, trials=20, specimens="other", phantoms=3, mounting="each_trial", rehome=False
    ),
    gel=RINGS,
    path_m=SWIFT.path_m,
)


@pytest.fixture(scope="module")
def one() -> WorldSession:
    return begin(PLAN, (3, 1))


@pytest.mark.slow
def test_the_ring_alone_is_what_most_bits_chooses_without_actions(one: WorldSession) -> None:
    known = offer(one, action_set(RINGS.rings_m, frozenset()).actions)
    chosen = run_action_trials(one, known, time_of(SWIFT))
    plain = run_trace_trials(
        one, model_of(one, settings_of(one)), SWIFT, asking=MostBits(RINGS.rings_m, SWIFT)
    )
    np.testing.assert_array_equal(chosen.ended.estimate, plain.ended.estimate)
    np.testing.assert_array_equal(chosen.ended.probes, plain.ended.probes)
    np.testing.assert_allclose(chosen.ended.confidence, plain.ended.confidence, atol=1e-9)
    np.testing.assert_allclose(chosen.ended.seconds, plain.ended.seconds, atol=1e-5)


def test_more_to_choose_is_faster_and_still_right(one: WorldSession) -> None:
    few = run_action_trials(one, offer(one, action_set(RINGS.rings_m, frozenset()).actions), time_of(SWIFT))
    asked = action_set(RINGS.rings_m, frozenset({"speed", "direction"}))
    more = run_action_trials(one, offer(one, asked.actions), time_of(SWIFT))
    assert more.ended.correct.mean() > 0.93
    assert more.ended.seconds.mean() < 0.9 * few.ended.seconds.mean()
    assert sum(count for (probe, _), count in more.asked.items() if probe == 0) == len(one.depth)


@pytest.mark.slow
def test_a_sweep_back_meets_the_same_mounting(one: WorldSession) -> None:
    every = np.arange(len(one.depth))
    there = SweepAction(0.016, 0.004, 0.02, *SWIFT.path_m)
    back = replace(there, from_m=there.to_m, to_m=there.from_m)
    none = np.zeros(len(every))
    first, second = (one.swept(action, every, none, 0) for action in (there, back))
    ring = np.ones(len(every), dtype=np.int64)
    np.testing.assert_array_equal(first, one.traces(every, ring, none, 0))
    assert (second[:, 45:] > 0.0).all()  # against the sweep
    fast = one.swept(replace(there, speed_m_per_s=0.04), every, none, 0)
    assert 0.0 < np.abs(fast - first)[:, 30:].mean() < 0.3e-3  # noise and stick-slip
