"""The ring's actuator: finite speed, an error that stays until it moves, and no word of the truth."""

from __future__ import annotations

import pytest

from msgs.actuator import RingCommand
from nodes.actuator import Actuator
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.graph.node.lifecycle import Transition


def to(ring_m: float, trial: int = 0, iteration: int = 1) -> RingCommand:
    return RingCommand(stamp_ns=0, trial=trial, iteration=iteration, ring_m=ring_m)


def home(trial: int = 0) -> RingCommand:
    return RingCommand(stamp_ns=0, trial=trial, iteration=0, ring_m=0.0, rehome=True)


def move(bench: Bench[Actuator], command: RingCommand) -> float:
    """Return where the ring rests in truth after a command."""
    bench.feed(Actuator.command, command)
    bench.advance(20.0)
    return bench.sent(Actuator.truth)[-1].ring_m


def test_it_moves_no_faster_than_5_mm_per_s_and_settles() -> None:
    bench = Bench(Actuator, {"repeatability_mm": 0.0})
    bench.feed(Actuator.command, to(0.016))
    bench.advance(1.0)
    assert bench.node.device.read(bench.clock.now_ns(), bench.node.state.device).measured_m == pytest.approx(
        0.005, abs=1e-4
    )
    bench.advance(10.0)
    begin, end = bench.sent(Actuator.ring_state)
    assert (begin.settled, end.settled) == (False, True)
    assert end.stamp_ns == pytest.approx((0.016 / 0.005 + 0.2) * 1e9, abs=10)
    assert bench.executor.next_due_ns() is None


def test_it_echoes_trial_and_iteration() -> None:
    bench = Bench(Actuator)
    move(bench, to(0.008, trial=3, iteration=5))
    assert {(s.trial, s.iteration) for s in bench.sent(Actuator.ring_state)} == {(3, 5)}
    assert (bench.sent(Actuator.truth)[-1].trial, bench.sent(Actuator.truth)[-1].iteration) == (3, 5)


def test_the_error_is_drawn_anew_on_every_move() -> None:
    bench = Bench(Actuator)
    errors_m = [move(bench, to(0.012)) - 0.012]
    for _ in range(40):
        move(bench, to(0.004))
        errors_m.append(move(bench, to(0.012)) - 0.012)
    assert len(set(errors_m)) == 41
    assert max(map(abs, errors_m)) <= 0.3e-3
    assert max(errors_m) > 0.15e-3
    assert min(errors_m) < -0.15e-3


def test_the_error_stays_while_the_ring_does_not_move() -> None:
    bench = Bench(Actuator)
    first = move(bench, to(0.016, iteration=1))
    bench.feed(Actuator.command, to(0.016, iteration=2))
    state, truth = bench.sent(Actuator.ring_state)[-1], bench.sent(Actuator.truth)[-1]
    assert (state.iteration, state.settled, state.stamp_ns) == (2, True, bench.clock.now_ns())
    assert (truth.iteration, truth.ring_m) == (2, first)
    assert bench.executor.next_due_ns() is None


def test_rehoming_returns_to_the_target_with_a_new_error() -> None:
    bench = Bench(Actuator)
    before = move(bench, to(0.016))
    after = move(bench, home(trial=7))
    assert after != before
    assert after == pytest.approx(0.016, abs=0.3e-3)
    last = bench.sent(Actuator.ring_state)[-1]
    assert (last.rehome, last.settled, last.trial, last.target_m) == (True, True, 7, 0.016)


def test_a_command_waits_for_the_end_of_rehoming() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, home(trial=1))
    bench.feed(Actuator.command, to(0.008, trial=1))
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


def test_a_second_rehoming_does_not_swallow_the_command_that_waits() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, home())
    bench.feed(Actuator.command, to(0.008))
    bench.feed(Actuator.ring, home())
    bench.advance(20.0)
    last = bench.sent(Actuator.ring_state)[-1]
    assert (last.rehome, last.settled, last.target_m) == (False, True, 0.008)


def test_a_new_command_on_the_way_replaces_the_old_one() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.command, to(0.016, iteration=1))
    bench.advance(1.0)
    assert move(bench, to(0.0, iteration=2)) == pytest.approx(0.0, abs=0.3e-3)
    assert [s.iteration for s in bench.sent(Actuator.ring_state) if s.settled] == [2]


def test_the_truth_is_told_on_the_truth_port_only() -> None:
    def told(repeatability_mm: float) -> list[tuple[float, float, bool]]:
        bench = Bench(Actuator, {"repeatability_mm": repeatability_mm}, seed=3)
        move(bench, to(0.012))
        return [(s.target_m, s.measured_m, s.settled) for s in bench.sent(Actuator.ring_state) if s.settled]

    assert told(0.3) == told(0.0)


def test_a_normal_error_has_the_data_sheets_band_at_two_deviations() -> None:
    bench = Bench(Actuator, {"ring_error": "normal"})
    errors_m = []
    for _ in range(150):
        move(bench, to(0.004))
        errors_m.append(move(bench, to(0.012)) - 0.012)
    inside = sum(abs(e) <= 0.3e-3 for e in errors_m) / len(errors_m)
    assert 0.88 < inside < 1.0


def test_a_target_beyond_the_stroke_is_refused() -> None:
    with pytest.raises(NodeError, match="target_m"):
        Bench(Actuator).feed(Actuator.command, to(0.2))


def test_the_same_seed_gives_the_same_errors() -> None:
    one, other, third = (Bench(Actuator, seed=seed) for seed in (5, 5, 6))
    assert move(one, to(0.012)) == move(other, to(0.012)) != move(third, to(0.012))


def test_a_replacement_finishes_the_move_with_the_same_error(successor, frames_of) -> None:  # type: ignore[no-untyped-def]
    whole, first = Bench(Actuator), Bench(Actuator)
    for bench in (whole, first):
        bench.feed(Actuator.ring, home())
        bench.feed(Actuator.command, to(0.012))
        bench.advance(0.3)
    second = successor(first)
    for bench in (whole, second):
        bench.advance(20.0)
        bench.feed(Actuator.command, to(0.012, iteration=2))
    assert frames_of(first) + frames_of(second) == frames_of(whole)


def test_an_actuator_that_was_deactivated_in_rehoming_obeys_again() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, home())
    bench.executor.transition(Transition.DEACTIVATE)
    bench.executor.transition(Transition.ACTIVATE)
    assert move(bench, to(0.008)) == pytest.approx(0.008, abs=0.3e-3)
