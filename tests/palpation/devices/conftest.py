"""What the devices' tests share: where the hardware is, an emulated rig, and waiting for events."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
from palp_core.palpation.devices.emulator.axis import AxisSettings
from tests.support.hardware import HARDWARE, Hardware, read_hardware

QUICK = RigSettings(
    y_axis=AxisSettings(home_s=0.02),
    z_axis=AxisSettings(soft_low_m=-0.001, home_s=0.02),
    stage_baud=0,
    maestro_baud=0,
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--hardware",
        default=None,
        metavar="CONFIG",
        help="YAML or TOML file of real devices for the contract suite, as docs/hardware.yaml",
    )


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """Test real devices in one process: no two tests may move the same stage."""
    return 0 if config.getoption("--hardware", default=None) else None


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption("--hardware", default=None)
    if path and config.getoption("numprocesses", default=0):
        raise pytest.UsageError("--hardware: no two tests may move the same stage; leave -n out, or -n 0")
    try:
        config.stash[HARDWARE] = read_hardware(Path(path)) if path else {}
    except DeviceError as error:
        raise pytest.UsageError(str(error)) from error


class Waiter:
    """Wait for events of other threads, never for a length of time."""

    def until(self, holds: Callable[[], object]) -> None:
        """Ask again and again until it holds; pytest ends a test that hangs."""
        while not holds():
            threading.Event().wait(0.002)


@pytest.fixture
def hardware(pytestconfig: pytest.Config) -> dict[str, Hardware]:
    """The devices of ``--hardware`` by kind; none without it."""
    return pytestconfig.stash[HARDWARE]


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
def quick_settings() -> RigSettings:
    return QUICK
