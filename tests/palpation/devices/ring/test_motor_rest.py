"""A motor that ran is as warm for the next driver; a way from outside of the window may not be free."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.ring.maestro import MaestroRing, MaestroState
from palp_core.palpation.devices.wire.aerotech import Fault

RNG = np.random.default_rng(0)
S = 1_000_000_000


def test_a_successor_of_the_driver_lets_the_motor_rest(
    quick_rig: Callable[..., EmulatedRig], patient: dict[str, dict[str, Any]]
) -> None:
    rig = quick_rig("maestro")
    options = {**rig.options["maestro"], **patient["maestro"], "duty": 0.02, "duty_window_s": 50.0}
    first, state = MaestroRing(**options), MaestroState()
    first.open(time.monotonic_ns(), state, RNG)
    first.command(0.0038, time.monotonic_ns(), state, RNG)  # 0.76 s; homing took 0.2 of the 1 s
    first.stop(time.monotonic_ns(), state)
    first.close()
    inherited = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=MaestroState)
    assert inherited.runs == state.runs
    second = MaestroRing(**options)
    now_ns = time.monotonic_ns()
    second.open(now_ns, inherited, RNG)
    try:
        assert second.command(0.0045, now_ns, inherited, RNG) > now_ns + 20 * S
    finally:
        second.close()


@pytest.mark.parametrize(("axis", "from_m"), [("y", 0.056), ("y", -0.056), ("z", -0.001), ("z", 0.056)])
def test_a_move_that_begins_outside_of_the_window_is_refused(axis: str, from_m: float) -> None:
    TravelLimits().check(axis, 0.0, 0.0, 0.010)
    with pytest.raises(DeviceError, match="start of a move"):
        TravelLimits().check(axis, from_m, 0.0, 0.010)


def test_a_fault_without_a_name_is_told_by_its_bit() -> None:
    assert Fault(1 << 13 | 1).words == "position error, bit 13"
    assert Fault(0).words == "none"
