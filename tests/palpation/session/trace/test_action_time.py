"""How long sweeps keep the rig: the protocol's own seconds, and what a sweep back saves."""

import numpy as np
import pytest

from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.palpation.session.trace.action_time import RigStanding
from palp_core.palpation.studies.frontier.action_trials import time_of
from palp_core.palpation.studies.frontier.protocols import PAPER_PROTOCOL, SWIFT, Protocol

RIG = time_of(SWIFT)
THERE = SweepAction(0.016, 0.004, 0.02, *SWIFT.path_m)
BACK = SweepAction(0.016, 0.004, 0.02, *SWIFT.path_m[::-1])
FAST = SweepAction(0.016, 0.004, 0.04, *SWIFT.path_m)


@pytest.mark.parametrize("protocol", [SWIFT, PAPER_PROTOCOL], ids=["swift", "paper"])
def test_sweeps_of_one_ring_take_what_the_protocol_says(protocol: Protocol) -> None:
    rig, at, expected, spent = time_of(protocol), RigStanding(), 0.0, 0.0
    action = SweepAction(0.016, 0.004, 0.02, *protocol.path_m)
    way = np.array([action.way_m])
    for _ in range(3):
        expected += rig.seconds([action], at)[0]
        spent += rig.to_s(action, at) + float(rig.sweep_s(action, way)[0])
        at = rig.after(action, at)
    assert expected == pytest.approx(spent + rig.home_s(action, way, at)[0])
    timing = protocol.timing
    ring_s = (0.016 + timing.home_m) / timing.ring_m_per_s + timing.settle_s if protocol.rehome else 0.0
    assert expected == pytest.approx(3.0 * timing.sweep_s + ring_s, abs=1e-6)


def test_a_sweep_that_is_stopped_takes_what_the_protocol_says() -> None:
    way = np.array([0.021, 0.06])
    np.testing.assert_allclose(RIG.sweep_s(THERE, way), SWIFT.sweep_s(way), rtol=1e-12)
    np.testing.assert_allclose(RIG.home_s(THERE, way, RigStanding()), SWIFT.back_s(way), atol=1e-6)


def test_a_sweep_back_saves_the_way_back() -> None:
    after = RIG.after(THERE, RigStanding())
    again, back = RIG.seconds([THERE, BACK], after)
    assert back < again - 1.0
    assert RIG.to_s(BACK, after) < RIG.to_s(THERE, after) - 1.0
    assert RIG.home_s(BACK, np.array([0.06]), after)[0] == pytest.approx(RIG.to_s(BACK, after), abs=1e-6)
    first = RIG.seconds([THERE, BACK], RigStanding())
    assert first[0] == pytest.approx(first[1])


def test_twice_the_speed_is_half_the_way_s_time_and_more_run_up() -> None:
    slow, fast = RIG.seconds([THERE, FAST], RigStanding())
    assert 1.35 < slow - fast < 1.5


def test_the_ring_s_way_counts_where_it_moves() -> None:
    at = RIG.after(THERE, RigStanding())
    other = SweepAction(0.012, 0.004, 0.02, *SWIFT.path_m)
    stays, moves = RIG.seconds([THERE, other], at)
    assert moves - stays == pytest.approx(0.004 / 5e-3 + 0.2)
    assert RIG.lands(other, at)
    assert not RIG.lands(THERE, at)
