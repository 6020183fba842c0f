"""What the devices' tests share: an emulated rig, and waiting for events."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
from palp_core.palpation.devices.emulator.axis import AxisSettings
from palp_core.palpation.devices.registry import kind_of

QUICK = RigSettings(
    y_axis=AxisSettings(home_s=0.02),
    z_axis=AxisSettings(soft_low_m=-0.001, home_s=0.02),
    stage_baud=0,
    maestro_baud=0,
)


class Waiter:
    """Wait for events of other threads, never for a length of time."""

    def until(self, holds: Callable[[], object]) -> None:
        """Ask again and again until it holds; pytest ends a test that hangs."""
        while not holds():
            threading.Event().wait(0.002)


@pytest.fixture
def patient() -> dict[str, dict[str, Any]]:
    """Options of the drivers with deadlines that a busy host does not pass, for tests of something else."""
    return {
        "aerotech": {"stale_s": 30.0, "timeout_s": 30.0},
        "maestro": {"stale_s": 30.0, "timeout_s": 30.0, "stall_s": 30.0},
        "ati": {"stale_s": 10.0, "timeout_s": 30.0, "lost_s": 30.0, "rate_hz": 100.0, "gap_s": 0.03},
        "noraxon": {"stale_s": 30.0, "timeout_s": 30.0},
        "lsl": {"stale_s": 30.0, "find_s": 60.0},
    }


@pytest.fixture
def wait() -> Waiter:
    return Waiter()


@pytest.fixture
def quick_rig() -> Iterator[Callable[..., EmulatedRig]]:
    """Start emulated rigs of the devices named, and stop them at the end."""
    rigs: list[EmulatedRig] = []

    def start(*devices: str, settings: RigSettings = QUICK) -> EmulatedRig:
        rig = EmulatedRig(settings, devices)
        rig.start()
        rigs.append(rig)
        return rig

    yield start
    for rig in rigs:
        rig.stop()


@pytest.fixture
def driver(
    quick_rig: Callable[..., EmulatedRig], patient: dict[str, dict[str, Any]]
) -> Iterator[Callable[..., Subject]]:
    """Open drivers of devices of emulated rigs, patient ones, and close them at the end."""
    with contextlib.ExitStack() as opened:

        def open_driver(rig: EmulatedRig, name: str, **options: Any) -> Subject:
            given = rig.options[name] | patient[name] | options
            subject = opened.enter_context(Subject(kind_of(name), name, given, patience_s=120.0))
            subject.call("open")
            return subject

        yield open_driver
