"""The simulated phantom: torque from pose, ring and mounting."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest

from msgs.actuator import RingTruth
from msgs.stage import StagePose
from nodes.phantom import Phantom
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.units import Float64Array
from tests.support.rig_messages import mount

PATH_M = np.linspace(-0.03, 0.05, 401)


def ring(ring_m: float) -> RingTruth:
    return RingTruth(stamp_ns=0, trial=0, iteration=1, ring_m=ring_m)


def pose(position_m: Float64Array = PATH_M, start_ns: int = 3_000_000, rate_hz: float = 100.0) -> StagePose:
    """At 20 mm/s, but for another rate."""
    return StagePose(stamp_ns=0, goal_id=9, start_ns=start_ns, rate_hz=rate_hz, position_m=position_m)


def torque_n_m(bench: Bench[Phantom], code: str = "A", ring_m: float = 0.016) -> Float64Array:
    bench.feed(Phantom.mount, mount(code))
    bench.feed(Phantom.ring, ring(ring_m))
    bench.feed(Phantom.pose, pose())
    return bench.sent(Phantom.contact)[-1].torque_n_m


@pytest.fixture
def flat() -> Bench[Phantom]:
    return Bench(Phantom, {"height_sd_mm": 0.0})


@pytest.mark.parametrize(
    ("given", "asked", "rungs"),
    [
        ({}, "peak", "l2 l2 l2"),
        ({"feature": "contrast"}, "contrast", "l4 l4 l4"),
        ({"reading": "trace"}, "trace", "l4 l4 l2"),
        ({"feature": "auto"}, "trace", "l4 l4 l2"),
    ],
)
def test_the_gel_is_right_in_what_the_run_reads(given: dict[str, str], asked: str, rungs: str) -> None:
    touched = Bench(Phantom, given).node.rig
    assert {choice.output for choice in touched.choices.values()} == {asked}
    assert [choice.name for choice in touched.choices.values()] == rungs.split()


def test_a_path_that_ends_near_the_bead_has_no_contrast_to_be_right_in() -> None:
    with pytest.raises(NodeError, match=r"no contact method gives 'contrast'.*margin_m = 0.015 is not in"):
        Bench(Phantom, {"feature": "contrast", "from_m": -0.015})


def test_a_failing_region_is_reported_once_per_mounting_and_ring(flat: Bench[Phantom]) -> None:
    torque_n_m(flat, "C")
    assert flat.sent(Phantom.guard) == []
    torque_n_m(flat, "A")
    flat.feed(Phantom.pose, pose())
    (guard,) = flat.sent(Phantom.guard)
    assert (guard.code, guard.remount, guard.ring_m) == ("A", 0, 0.016)
    assert "small strain" in guard.words[0]


def test_a_stage_too_fast_to_leave_inertia_out_is_reported_and_so_is_one_that_is_slow_again(
    flat: Bench[Phantom],
) -> None:
    torque_n_m(flat, "C")
    assert flat.sent(Phantom.guard) == []
    flat.feed(Phantom.pose, pose(rate_hz=300.0))  # 60 mm/s
    (fast,) = flat.sent(Phantom.guard)
    assert fast.words == [
        "inertia: quasi_static: no error bound for 'peak': speed_m_s = 0.06 is not in [0, 0.05]; "
        "dynamic is the next finer one"
    ]
    flat.feed(Phantom.ring, ring(0.012))
    flat.feed(Phantom.pose, pose(rate_hz=300.0), pose(rate_hz=300.0), pose())
    again, slow = flat.sent(Phantom.guard)[1:]
    assert (again.ring_m, again.words, slow.words) == (0.012, fast.words, [])
    speeds = [
        json.loads(use.scene)["speed_m_s"]
        for shown in flat.sent(Phantom.methods)
        for use in shown.uses
        if use.task == "motion"
    ]
    assert speeds == [0.02, 0.06, 0.02]


def test_it_says_which_rung_is_for_each_phantom_and_on_what(flat: Bench[Phantom]) -> None:
    (shown,) = flat.sent(Phantom.methods)
    rungs = {use.of: use for use in shown.uses if use.task == "contact"}
    assert set(rungs) == {"A", "B", "C"}
    for code, use in rungs.items():
        choice = flat.node.rig.choices[code]
        assert (use.name, use.bound, use.asked) == (choice.name, choice.bound, False)
        assert json.loads(use.scene)["phantom"] == asdict(flat.node.rig.phantoms[code])


def test_each_remount_draws_the_height_again() -> None:
    bench = Bench(Phantom, {"height_sd_mm": 0.1})
    for remount in range(200):
        bench.feed(Phantom.mount, mount("A", remount))
    heights_m = np.array([t.height_offset_m for t in bench.sent(Phantom.truth)])
    assert len(set(heights_m)) == 200
    assert heights_m.std() == pytest.approx(0.1e-3, rel=0.2)


def test_the_torque_does_not_depend_on_the_blocks(flat: Bench[Phantom]) -> None:
    whole = torque_n_m(flat)
    for part in np.array_split(PATH_M, 7):
        flat.feed(Phantom.pose, pose(part))
    parts = [c.torque_n_m for c in flat.sent(Phantom.contact)[-7:]]
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0.0, atol=1e-15)


def test_an_unknown_code_is_named(flat: Bench[Phantom]) -> None:
    with pytest.raises(NodeError, match="no phantom 'Z'; there are A, B, C"):
        flat.feed(Phantom.mount, mount("Z"))


def test_a_sweep_over_nothing_is_an_error(flat: Bench[Phantom]) -> None:
    with pytest.raises(NodeError, match="no phantom is mounted"):
        flat.feed(Phantom.pose, pose())
