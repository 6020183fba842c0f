"""The estimator that reads whole traces: a belief within the sweep, the same for all who follow it."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msgs.estimation import Outlook
from msgs.stage import SweepStatus
from msgs.torque import TorqueBlock
from nodes.estimator import Estimator
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.units import Float64Array
from tests.support.kept import replace, sent_bytes
from tests.support.rig_messages import block, ring_state, trial

DEPTHS_M, RINGS_M = (0.002, 0.004, 0.008), (0.008, 0.016)
FROM_M, TO_M, SPEED = -0.02, 0.03, 0.02
COUNT = 2500
PARAMS: dict[str, Any] = {
    "reading": "trace",
    "stop": "posterior_threshold",
    "stop_value": 0.99,
    "from_m": FROM_M,
    "to_m": TO_M,
    # torques by a formula answer to none of the mechanics' offsets, and have no texture
    "trace_filter": "second_order",
    "modulus_sd": 0.05,
    "place_sd_mm": 0.3,
    "tip_sd_mm": 0.02,
    "bias_sd_n_mm": 0.0,
    "slope_error": 0.0,
    "texture_sd_n_mm": 0.05,
    "texture_length_mm": 4.0,
}
CLEAN: dict[tuple[float, float], Float64Array] = {}


@pytest.fixture(scope="module", autouse=True)
def _coarse_mechanics(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let the register take the cheapest contact model for the slopes: finite elements take half a minute."""
    scene = tmp_path_factory.mktemp("scene") / "scene.yaml"
    scene.write_text("tolerance: {relative: 1.0}\n")
    PARAMS["scene"] = str(scene)


def touched(depth_m: float, ring_m: float) -> Float64Array:
    """Torque of a sweep, by a formula: a rise and a fall, higher the shallower and the stiffer."""
    stage_m = FROM_M + SPEED * 1e-3 * np.arange(COUNT)
    over = np.exp(-(((stage_m - 0.008) / 0.007) ** 2))
    return np.asarray(ring_m * (0.9 + 0.3 * over * (1.0 - depth_m / 0.010)))


def felt(depth_m: float, ring_m: float = 0.016, seed: int = 1) -> Float64Array:
    return touched(depth_m, ring_m) + np.random.default_rng(seed).normal(0.0, 2e-5, COUNT)


def status(word: str, count: int = 0, start_ns: int = 0) -> SweepStatus:
    leave_ns = start_ns + COUNT * 1_000_000
    return SweepStatus(
        stamp_ns=0, goal_id=1, status=word, enter_ns=start_ns, leave_ns=leave_ns, sample_count=count
    )


def palpate(bench: Bench[Estimator], torque_n_m: Float64Array) -> None:
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(torque_n_m))
    bench.feed(Estimator.sweep, status("swept", len(torque_n_m)))


@cache
def taught() -> Bench[Estimator]:
    """Return a bench that has felt every cell of training; the tests go on from what it hands over."""
    bench = Bench(Estimator, PARAMS)
    for number, (depth_m, ring_m, repeat) in enumerate(itertools.product(DEPTHS_M, RINGS_M, range(4))):
        bench.feed(Estimator.trial, trial(number, "training", depth_m, code=f"{depth_m}"))
        bench.feed(Estimator.ring, ring_state(ring_m, number))
        palpate(bench, felt(depth_m, ring_m, 1000 * number + repeat))
    return bench


def trained(**params: object) -> Bench[Estimator]:
    """Return a bench at the start of a trial at the stiffest ring."""
    bench: Bench[Estimator] = replace(taught())
    bench.set_parameters(**params)
    begin(bench)
    return bench


def begin(bench: Bench[Estimator], number: int = 500, iteration: int = 1, ring_m: float = 0.016) -> None:
    bench.feed(Estimator.trial, trial(number, "estimation"))
    bench.feed(Estimator.ring, ring_state(ring_m, number, iteration))


def blocks(torque_n_m: Float64Array, size: int = 50) -> list[TorqueBlock]:
    return [block(torque_n_m[at : at + size], at) for at in range(0, len(torque_n_m), size)]


def until_decided(bench: Bench[Estimator], torque_n_m: Float64Array) -> int:
    """Feed a sweep block by block until it is decided; return how many samples that took."""
    bench.feed(Estimator.sweep, status("sweeping"))
    before = len(outlooks(bench))
    for number, one in enumerate(blocks(torque_n_m)):
        bench.feed(Estimator.torque, one)
        if len(outlooks(bench)) > before and outlooks(bench)[-1].verdict == "decided":
            return 50 * (number + 1)
    return len(torque_n_m)


def outlooks(bench: Bench[Estimator]) -> list[Outlook]:
    return bench.sent(Estimator.outlook)


@pytest.mark.parametrize("depth_m", DEPTHS_M)
def test_it_decides_within_the_sweep_and_the_trial_ends_with_that_reading(depth_m: float) -> None:
    bench = trained()
    count = until_decided(bench, felt(depth_m))
    assert 0 < count < COUNT
    decided = outlooks(bench)[-1]
    assert decided.estimate_m == depth_m
    assert decided.confidence >= 0.99
    assert [one.verdict for one in outlooks(bench)[:-1]] == ["continue"] * (len(outlooks(bench)) - 1)
    assert bench.sent(Estimator.belief) == []
    bench.feed(Estimator.sweep, status("cancelled", count))
    (belief,) = bench.sent(Estimator.belief)
    np.testing.assert_array_equal(belief.posterior, decided.posterior)
    assert (belief.verdict, belief.trial, belief.iteration) == ("decided", 500, 1)
    palpation = bench.sent(Estimator.palpation)[-1]
    np.testing.assert_array_equal(palpation.torque_n_m, felt(depth_m)[:count])


@settings(max_examples=4, deadline=None)
@given(cuts=st.lists(st.integers(1, COUNT - 1), unique=True, max_size=9))
def test_the_belief_does_not_depend_on_the_blocks(cuts: list[int]) -> None:
    bench, whole = trained(), trained()
    torque_n_m = felt(0.004)
    bench.feed(Estimator.sweep, status("sweeping"))
    for low, high in itertools.pairwise([0, *sorted(cuts), COUNT]):
        bench.feed(Estimator.torque, block(torque_n_m[low:high], low))
    bench.feed(Estimator.sweep, status("swept", COUNT))
    palpate(whole, torque_n_m)
    (one,), (other,) = bench.sent(Estimator.belief), whole.sent(Estimator.belief)
    np.testing.assert_array_equal(one.posterior, other.posterior)
    assert one.verdict == other.verdict == "decided"


def test_a_sweep_that_decides_nothing_goes_on_with_the_next() -> None:
    bench = trained(stop_value=0.999999999999, texture_sd_n_mm=3.0)
    assert until_decided(bench, felt(0.004)) == COUNT
    bench.feed(Estimator.sweep, status("swept", COUNT))
    first = bench.sent(Estimator.belief)[-1]
    assert first.verdict == "continue"
    bench.feed(Estimator.ring, ring_state(0.008, 500, 2))
    palpate(bench, felt(0.004, 0.008))
    second = bench.sent(Estimator.belief)[-1]
    assert second.iteration == 2
    assert second.posterior[1] > first.posterior[1]


def test_a_rule_that_counts_probes_is_asked_at_the_end_of_a_sweep_only() -> None:
    bench = trained(stop="fixed_number", stop_value=1.0)
    assert until_decided(bench, felt(0.002)) == COUNT
    assert outlooks(bench)[-1].confidence > 0.9
    bench.feed(Estimator.sweep, status("swept", COUNT))
    assert bench.sent(Estimator.belief)[-1].verdict == "decided"


def test_a_decision_that_the_sweeps_end_overtakes_is_the_reading_all_the_same() -> None:
    bench = trained()
    count = until_decided(bench, felt(0.002))
    decided = outlooks(bench)[-1]
    for one in blocks(felt(0.002))[count // 50 :]:
        bench.feed(Estimator.torque, one)
    bench.feed(Estimator.sweep, status("swept", COUNT))
    bench.feed(Estimator.sweep, status("cancelled", COUNT))  # the experiment's cancel came too late
    (belief,) = bench.sent(Estimator.belief)
    np.testing.assert_array_equal(belief.posterior, decided.posterior)
    assert len(bench.sent(Estimator.palpation)[-1].torque_n_m) == COUNT
    assert outlooks(bench)[-1].stamp_ns == decided.stamp_ns
    assert [one.verdict for one in outlooks(bench)].count("decided") == 1


def test_a_sweep_that_is_cancelled_undecided_is_felt_again_from_its_beginning() -> None:
    bench, fresh = trained(), trained()
    bench.feed(Estimator.sweep, status("sweeping"))
    for one in blocks(felt(0.008))[:10]:
        bench.feed(Estimator.torque, one)
    bench.feed(Estimator.sweep, status("cancelled", 500))
    bench.feed(Estimator.torque, block(felt(0.008)[500:550], 500))  # that was under way
    for each in (bench, fresh):
        until_decided(each, felt(0.002))
    np.testing.assert_array_equal(outlooks(bench)[-1].posterior, outlooks(fresh)[-1].posterior)
    assert bench.sent(Estimator.belief) == []


def test_a_sweep_of_the_trial_before_says_nothing_of_the_next() -> None:
    bench, fresh = trained(), trained()
    count = until_decided(bench, felt(0.008))
    begin(bench, 501)
    bench.feed(Estimator.torque, block(felt(0.008)[count : count + 50], count))
    bench.feed(Estimator.sweep, status("cancelled", count))
    assert bench.sent(Estimator.belief) == []
    before = len(outlooks(bench))
    for each in (bench, fresh):
        until_decided(each, felt(0.002))
    beliefs = [[one.posterior.tolist() for one in outlooks(each)] for each in (bench, fresh)]
    assert beliefs[0][before:] == beliefs[1]


@pytest.mark.parametrize("at", [0, 12, 60])
def test_a_replacement_goes_on_in_the_middle_of_a_sweep_to_the_same_bytes(at: int) -> None:
    whole, first = trained(), trained()
    for bench in (whole, first):
        bench.feed(Estimator.sweep, status("sweeping"))
    feed = blocks(felt(0.004))
    for one in feed[:at]:
        first.feed(Estimator.torque, one)
    second = replace(first)
    for bench, rest in ((whole, feed), (second, feed[at:])):
        for one in rest:
            bench.feed(Estimator.torque, one)
        bench.feed(Estimator.sweep, status("cancelled", COUNT))
    assert sent_bytes(first) + sent_bytes(second) == sent_bytes(whole)
    assert second.sent(Estimator.belief)[-1].verdict == "decided"


def test_who_reads_otherwise_cannot_take_over_and_an_untrained_ring_ends_the_trial() -> None:
    bench = trained()
    with pytest.raises((NodeError, ValueError), match="training used another one"):
        replace(bench, Estimator, reading="feature")
    begin(bench, 501, ring_m=0.010)
    palpate(bench, felt(0.002))
    assert bench.sent(Estimator.belief)[-1].verdict == "dropped"
    assert outlooks(bench) == []


def test_a_torque_that_fits_no_class_is_an_outlier() -> None:
    bench = trained()
    palpate(bench, felt(0.004))
    assert not bench.sent(Estimator.belief)[-1].outlier
    begin(bench, 501)
    strange = felt(0.004)
    strange[300:500] += 3e-3
    palpate(bench, strange)
    assert bench.sent(Estimator.belief)[-1].outlier


def streamed(bench: Bench[Estimator], torque_n_m: Float64Array, start_ns: int, size: int = 20) -> int:
    """Feed a stream whose samples lie between those of the grid; return when the sweep in it begins."""
    before = np.full(500, torque_n_m[0])
    stream = np.concatenate([before, torque_n_m, np.full(200, torque_n_m[-1])])
    sweep_ns = start_ns + 500_000_000
    for at in range(0, len(stream), size):
        if at == 500:
            bench.feed(Estimator.sweep, status("sweeping", start_ns=sweep_ns))
        first_ns = start_ns + at * 1_000_000 + 300_000
        bench.feed(Estimator.torque, block(stream[at : at + size], start_ns=first_ns, over_phantom=False))
    return sweep_ns


def test_a_stream_is_followed_as_it_comes() -> None:
    bench = Bench(Estimator, PARAMS)
    for number, (depth_m, ring_m) in enumerate(itertools.product(DEPTHS_M, RINGS_M)):
        bench.feed(Estimator.trial, trial(number, "training", depth_m, code=f"{depth_m}"))
        bench.feed(Estimator.ring, ring_state(ring_m, number))
        sweep_ns = streamed(bench, felt(depth_m, ring_m, number), (1 + 5 * number) * 10**9, size=100)
        bench.feed(Estimator.sweep, status("swept", start_ns=sweep_ns))
    assert [len(p.torque_n_m) for p in bench.sent(Estimator.palpation)] == [COUNT + 1] * 6
    bench.set_parameters(stop_value=0.8)  # training had one landing a cell
    begin(bench)
    sweep_ns = streamed(bench, felt(0.002, seed=9), 31 * 10**9)
    assert outlooks(bench)[-1].verdict == "decided"
    assert outlooks(bench)[-1].estimate_m == 0.002
    bench.feed(Estimator.sweep, status("cancelled", start_ns=sweep_ns))
    (belief,) = bench.sent(Estimator.belief)
    np.testing.assert_array_equal(belief.posterior, outlooks(bench)[-1].posterior)
