"""What the devices' tests share: where the hardware is, an emulated rig, and waiting for events."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from palp_core.devices.emulator import EmulatedRig, RigSettings
from palp_core.devices.emulator.axis import AxisSettings
from palp_core.devices.emulator.world import WorldSettings

QUICK = RigSettings(
    world=WorldSettings(
        y_axis=AxisSettings(home_s=0.02), z_axis=AxisSettings(soft_low_m=-0.001, home_s=0.02)
    ),
    stage_baud=0,
    maestro_baud=0,
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--hardware",
        default=None,
        metavar="CONFIG",
        help="YAML file of real devices for the contract suite: kind: {device: NAME, options: {...}}",
    )


@dataclass
class Waiter:
    """Wait for events of other threads, never for a length of time that an assertion depends on."""

    timeout_s: float = 20.0

    def until(self, holds: Callable[[], object]) -> None:
        """Ask again and again until it holds; fail after a time that only a hang reaches."""
        pause, end_s = threading.Event(), time.monotonic() + self.timeout_s
        while not holds():
            assert time.monotonic() < end_s, "waited in vain"
            pause.wait(0.002)


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
def quick_settings() -> RigSettings:
    return QUICK
