"""A leg in parts: the same way, none longer than allowed, so that a dead host costs one part at most."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.stage.aerotech import AerotechStage, AerotechState
from palp_core.palpation.devices.stage.aerotech_motion import Leg, in_segments

PLACE = st.floats(-60.0, 60.0)


@settings(max_examples=50, deadline=None)
@given(start_mm=PLACE, target_mm=PLACE, longest_m=st.floats(0.5e-3, 0.1))
def test_parts_make_up_the_leg_and_none_is_too_long(
    start_mm: float, target_mm: float, longest_m: float
) -> None:
    leg = Leg("X", start_mm, target_mm, 20.0, abs(target_mm - start_mm) * 1e-3)
    parts = in_segments([leg], longest_m)
    assert parts[0].start_mm == start_mm
    assert parts[-1].target_mm == target_mm
    assert sum(part.length_m for part in parts) == pytest.approx(leg.length_m)
    for before, after in pairwise(parts):
        assert before.target_mm == pytest.approx(after.start_mm)
    assert all(part.length_m <= longest_m * (1.0 + 1e-6) for part in parts)


def test_without_a_limit_a_leg_stays_whole() -> None:
    leg = Leg("X", 0.0, 50.0, 20.0, 0.05)
    assert in_segments([leg], 0.0) == [leg]


def test_no_command_on_a_single_line_goes_further_than_2_mm(
    quick_rig: Callable[..., EmulatedRig], wait: Any, patient: dict[str, dict[str, Any]]
) -> None:
    rig = quick_rig("aerotech")
    stage = AerotechStage(
        **rig.options["aerotech"], **patient["aerotech"], segment_m=0.002, lift_m=0.004, poll_hz=200.0
    )
    state, rng = AerotechState(), np.random.default_rng(0)
    stage.open(time.monotonic_ns(), state, rng)
    stage.return_to(stage.sweep_start(-0.005, 0.005), time.monotonic_ns(), state)
    wait.until(lambda: not stage.feedback(time.monotonic_ns(), state).moving)
    stage.sweep(-0.005, 0.005, time.monotonic_ns(), state)
    wait.until(lambda: not stage.feedback(time.monotonic_ns(), state).moving)
    stage.close()
    place = {"X": 0.0, "Y": 0.0}
    lines = [line.split() for _, _, line in rig.call(lambda _: list(rig.axes.log))]
    moves = [(words[1], float(words[2])) for words in lines if words[0] == "MOVEABS"]
    assert len(moves) >= 15
    for axis, target_mm in moves:
        assert abs(target_mm - place[axis]) <= 2.0 + 1e-3
        place[axis] = target_mm
    assert place["X"] == pytest.approx(5.0 + 1.2, abs=0.01)
