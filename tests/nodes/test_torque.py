"""The torque sensor: noise and resolution over what acts, and silence while nothing is swept."""

from __future__ import annotations

import numpy as np

from msgs.torque import Contact
from nodes.torque import Torque
from palp_core import Bench
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array

STEP_N_M = 1e-3 / 64


def contact(torque_n_m: Float64Array, start_ns: int = 5_000_000) -> Contact:
    return Contact(stamp_ns=0, goal_id=1, start_ns=start_ns, rate_hz=1000.0, torque_n_m=torque_n_m)


def test_nothing_is_measured_while_nothing_is_swept() -> None:
    bench = Bench(Torque)
    bench.advance(60.0)
    assert bench.sent(Torque.block) == []
    assert bench.executor.next_due_ns() is None


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
