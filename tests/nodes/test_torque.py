"""The torque sensor: noise and resolution over what acts, and silence while nothing is swept."""

from __future__ import annotations

import numpy as np
import pytest

from msgs.torque import Contact
from nodes.torque import Torque
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array

STEP_N_M = 1e-3 / 64


def contact(torque_n_m: Float64Array, start_ns: int = 5_000_000) -> Contact:
    return Contact(stamp_ns=0, goal_id=1, start_ns=start_ns, rate_hz=1000.0, torque_n_m=torque_n_m)


def measure(torque_n_m: Float64Array, **params: float) -> Float64Array:
    bench = Bench(Torque, params)
    bench.feed(Torque.contact, contact(torque_n_m))
    return bench.sent(Torque.block)[-1].torque_n_m


def test_a_block_keeps_time_rate_and_length() -> None:
    bench = Bench(Torque)
    bench.feed(Torque.contact, contact(np.full(50, 0.02)))
    block = bench.sent(Torque.block)[0]
    assert (block.start_ns, block.rate_hz, len(block.torque_n_m)) == (5_000_000, 1000.0, 50)
    assert block.over_phantom


def test_readings_lie_on_the_steps_of_the_resolution() -> None:
    steps = measure(np.linspace(0.0, 0.02, 500)) / STEP_N_M
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)


def test_the_noise_has_the_stated_deviation_and_no_bias() -> None:
    readings = measure(np.full(20_000, 0.0201), noise_sd_n_mm=0.05)
    expected = np.hypot(0.05e-3, STEP_N_M / np.sqrt(12.0))
    assert readings.std() == pytest.approx(expected, rel=0.03)
    assert readings.mean() == pytest.approx(0.0201, abs=2e-6)


def test_without_noise_and_resolution_it_tells_the_truth() -> None:
    torque_n_m = np.linspace(-0.01, 0.03, 77)
    np.testing.assert_array_equal(measure(torque_n_m, noise_sd_n_mm=0.0, resolution_n_mm=0.0), torque_n_m)


def test_the_noise_does_not_depend_on_the_blocks() -> None:
    torque_n_m = np.linspace(0.0, 0.02, 300)
    whole, parts = Bench(Torque), Bench(Torque)
    whole.feed(Torque.contact, contact(torque_n_m))
    for i in (0, 7, 150):
        end = {0: 7, 7: 150, 150: 300}[i]
        parts.feed(Torque.contact, contact(torque_n_m[i:end], 5_000_000 + i * 1_000_000))
    joined = np.concatenate([block.torque_n_m for block in parts.sent(Torque.block)])
    np.testing.assert_array_equal(joined, whole.sent(Torque.block)[0].torque_n_m)


def test_a_torque_beyond_the_range_is_clipped_and_counted() -> None:
    bench = Bench(Torque)
    bench.feed(Torque.contact, contact(np.array([0.0, 0.5, -0.5])))
    block = bench.sent(Torque.block)[0]
    assert block.saturated_count == 2
    assert np.abs(block.torque_n_m).max() == pytest.approx(0.120)


def test_nothing_is_measured_while_nothing_is_swept() -> None:
    bench = Bench(Torque)
    bench.advance(60.0)
    assert bench.sent(Torque.block) == []
    assert bench.executor.next_due_ns() is None


def test_an_unknown_sensor_is_named() -> None:
    with pytest.raises(NodeError, match="no torque device 'nano99'; known: "):
        Bench(Torque, {"device": "nano99"})


def test_a_replacement_continues_drift_and_noise(successor, frames_of) -> None:  # type: ignore[no-untyped-def]
    params = {"bias_drift_n_mm_per_sqrt_s": 0.5}
    whole, first = Bench(Torque, params), Bench(Torque, params)
    for bench in (whole, first):
        bench.feed(Torque.contact, contact(np.zeros(200)))
    second = successor(first)
    for bench in (whole, second):
        bench.feed(Torque.contact, contact(np.zeros(200), 300_000_000))
    assert frames_of(first) + frames_of(second) == frames_of(whole)


def test_in_the_labs_world_the_zero_walks_where_no_walk_is_given() -> None:
    def ends(**params: object) -> Float64Array:
        bench = Bench(Torque, params, seed=2)
        for second in (0, 4000):
            bench.feed(Torque.contact, contact(np.zeros(50), start_ns=second * 1_000_000_000))
        return bench.sent(Torque.block)[-1].torque_n_m

    own = LAB.bias_walk_n_m_per_sqrt_s * 1e3
    np.testing.assert_array_equal(ends(world="lab"), ends(bias_drift_n_mm_per_sqrt_s=own))
    given = {"bias_drift_n_mm_per_sqrt_s": 3 * own}
    np.testing.assert_array_equal(ends(world="lab", **given), ends(**given))
    assert abs(ends(world="lab").mean() - ends().mean()) > 2 * STEP_N_M
