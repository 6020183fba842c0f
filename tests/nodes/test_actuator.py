"""The ring's actuator: finite speed, an error that stays until it moves, and no word of the truth."""

from __future__ import annotations

import pytest

from msgs.actuator import RingCommand
from nodes.actuator import Actuator
from palp_core import Bench
from palp_core.graph.node.lifecycle import Transition
from tests.support.rig_messages import ring_command

HOME = ring_command(0.0, rehome=True)


def move(bench: Bench[Actuator], command: RingCommand) -> float:
    """Return where the ring rests in truth after a command."""
    bench.feed(Actuator.command, command)
    bench.advance(20.0)
    return bench.sent(Actuator.truth)[-1].ring_m


def test_it_moves_no_faster_than_5_mm_per_s_and_settles() -> None:
    bench = Bench(Actuator, {"repeatability_mm": 0.0})
    bench.feed(Actuator.command, ring_command(0.016))
    bench.advance(1.0)
    assert bench.node.device.read(bench.clock.now_ns(), bench.node.state.device).measured_m == pytest.approx(
        0.005, abs=1e-4
    )
    bench.advance(10.0)
    begin, end = bench.sent(Actuator.ring_state)
    assert (begin.settled, end.settled) == (False, True)
    assert end.stamp_ns == pytest.approx((0.016 / 0.005 + 0.2) * 1e9, abs=10)
    assert bench.executor.next_due_ns() is None


def test_a_command_waits_for_the_end_of_rehoming() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, HOME)
    bench.feed(Actuator.command, ring_command(0.008))
    assert len(bench.sent(Actuator.ring_state)) == 1
    bench.advance(20.0)
    states = bench.sent(Actuator.ring_state)
    assert [(s.rehome, s.settled) for s in states] == [
        (True, False),
        (True, True),
        (False, False),
        (False, True),
    ]
    assert states[-1].target_m == 0.008


def test_a_command_on_the_way_is_followed_after_it_as_by_a_real_ring() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.command, ring_command(0.016, iteration=1))
    bench.advance(1.0)
    assert move(bench, ring_command(0.0, iteration=2)) == pytest.approx(0.0, abs=0.3e-3)
    assert [s.iteration for s in bench.sent(Actuator.ring_state) if s.settled] == [1, 2]


def test_the_truth_is_reported_on_the_truth_port_only() -> None:
    def given(repeatability_mm: float) -> list[tuple[float, float, bool]]:
        bench = Bench(Actuator, {"repeatability_mm": repeatability_mm}, seed=3)
        move(bench, ring_command(0.012))
        return [(s.target_m, s.measured_m, s.settled) for s in bench.sent(Actuator.ring_state) if s.settled]

    assert given(0.3) == given(0.0)


def test_an_actuator_that_was_deactivated_in_rehoming_obeys_again() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, HOME)
    bench.executor.transition(Transition.DEACTIVATE)
    bench.executor.transition(Transition.ACTIVATE)
    assert move(bench, ring_command(0.008)) == pytest.approx(0.008, abs=0.3e-3)
