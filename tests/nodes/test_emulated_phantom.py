"""The emulated laboratory: devices at their addresses, and the phantom that is asked for."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from msgs.experiment import Mount
from nodes.emulated_phantom import EmulatedPhantom
from palp_core import Bench
from palp_core.runtime.lifecycle import Transition

PORTS = {"stage_port": 0, "stop_port": 0, "can_port": 0, "emg_port": 0}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench[EmulatedPhantom]]:
    started = Bench(EmulatedPhantom, {**PORTS, "folder": str(tmp_path), "height_sd_mm": 0.1}, seed=3)
    yield started
    started.executor.transition(Transition.SHUTDOWN)


def test_the_devices_are_there(bench: Bench[EmulatedPhantom], tmp_path: Path) -> None:
    options = bench.node.rig.options
    assert set(options) == {"aerotech", "maestro", "ati", "noraxon"}
    assert (tmp_path / "maestro").is_symlink()
    socket.create_connection((options["noraxon"]["host"], options["noraxon"]["port"])).close()


def test_each_mounting_has_its_own_height_and_is_told(bench: Bench[EmulatedPhantom]) -> None:
    bench.feed(EmulatedPhantom.mount, Mount(stamp_ns=0, code="A", remount=0))
    bench.feed(EmulatedPhantom.mount, Mount(stamp_ns=0, code="C", remount=1))
    first, second = bench.sent(EmulatedPhantom.truth)
    assert (first.code, second.code) == ("A", "C")
    assert first.height_offset_m != second.height_offset_m
    assert 0.0 < first.depth_m < second.depth_m


def test_the_probe_starts_raised(bench: Bench[EmulatedPhantom]) -> None:
    truth = bench.node.rig.on_world(lambda world, now_ns: world.truth(now_ns))
    assert truth["z_m"] == 0.020
    assert truth["torque_n_m"] == 0.0
