"""The emulated laboratory: devices at their addresses, and the phantom that is asked for."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from nodes.emulated_phantom import EmulatedPhantom
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise, write_noise
from tests.support.rig_messages import mount

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


def test_each_mounting_has_its_own_height_and_is_reported(bench: Bench[EmulatedPhantom]) -> None:
    bench.feed(EmulatedPhantom.mount, mount("A", 0))
    bench.feed(EmulatedPhantom.mount, mount("C", 1))
    first, second = bench.sent(EmulatedPhantom.truth)
    assert (first.code, second.code) == ("A", "C")
    assert first.height_offset_m != second.height_offset_m
    assert 0.0 < first.depth_m < second.depth_m


def test_the_probe_starts_raised(bench: Bench[EmulatedPhantom]) -> None:
    truth = bench.node.rig.call(bench.node.rig.truth)
    assert truth["z_m"] == 0.020
    assert truth["torque_n_m"] == 0.0


def test_a_failing_region_is_reported_once_per_mounting_and_ring_and_only_when_it_was_touched(
    tmp_path: Path,
) -> None:
    exact = {"repeatability_mm": 0.0, "height_sd_mm": 0.0}
    bench = Bench(EmulatedPhantom, {**PORTS, **exact, "folder": str(tmp_path)}, seed=3)

    rig: EmulatedRig = bench.node.rig

    def touch(now_ns: int) -> None:
        rig.rod.move(0.017, 6e-3, 0)
        rig.contact.loads(now_ns)  # raised: nothing is felt
        assert not rig.contact.guards
        rig.axes.z.move(0.0, 0.05, 0)
        rig.contact.loads(60_000_000_000)
        rig.contact.loads(60_000_000_000)
        rig.axes.z.move(0.02, 0.05, 60_000_000_000)

    def touched(code: str, remount: int) -> list[tuple[str, int, float]]:
        bench.feed(EmulatedPhantom.mount, mount(code, remount))
        rig.call(touch)
        bench.advance(0.3)
        given = bench.sent(EmulatedPhantom.guard)
        return [(guard.code, guard.remount, round(guard.ring_m, 9)) for guard in given]

    assert touched("C", 0) == []
    assert touched("A", 1) == [("A", 1, 0.016)]
    assert "small strain" in bench.sent(EmulatedPhantom.guard)[0].words[0]
    assert touched("A", 2) == [("A", 1, 0.016), ("A", 2, 0.016)]

    def sweep(_: int) -> None:
        rig.axes.z.move(0.0, 0.05, 60_000_000_000)
        rig.axes.y.move(0.03, 0.2, 70_000_000_000)
        rig.contact.loads(70_050_000_000)

    rig.call(sweep)
    bench.advance(0.3)
    assert any("inertia: quasi_static" in words for words in bench.sent(EmulatedPhantom.guard)[-1].words)
    assert any(use.task == "motion" for use in bench.sent(EmulatedPhantom.methods)[-1].uses)
    bench.executor.transition(Transition.SHUTDOWN)


def test_a_noise_file_has_the_spreads_of_torque_ring_and_height(tmp_path: Path) -> None:
    noise = RigNoise(
        sample_sd_n_m=Component(3e-5),
        sweep_sd_n_m=Component(0.0),
        ring_sd_m=Component(0.0),
        height_sd_m=Component(0.0),
    )
    write_noise(noise, tmp_path / "noise.yaml")
    params = {**PORTS, "folder": str(tmp_path), "noise": str(tmp_path / "noise.yaml")}
    quiet = Bench(EmulatedPhantom, params, seed=3)
    quiet.feed(EmulatedPhantom.mount, mount("A", 0))
    (truth,) = quiet.sent(EmulatedPhantom.truth)
    assert truth.height_offset_m == 0.0

    rig: EmulatedRig = quiet.node.rig

    def torque_noise(now_ns: int) -> float:
        rig.rod.move(0.013, 6e-3, 0)
        assert rig.rod.ring_m(60_000_000_000) == pytest.approx(0.012, abs=1e-12)
        return float(np.std([rig.sensor.wrench(now_ns)[3] for _ in range(2000)]))

    assert rig.call(torque_noise) == pytest.approx(3e-5, rel=0.1)
    quiet.executor.transition(Transition.SHUTDOWN)


def test_a_noise_file_that_is_none_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(NodeError, match="cannot read the noise file"):
        Bench(EmulatedPhantom, {**PORTS, "folder": str(tmp_path), "noise": "no-such.yaml"})


def test_in_the_labs_world_each_mounting_reports_what_it_is_off_by(tmp_path: Path) -> None:
    bench = Bench(EmulatedPhantom, {**PORTS, "folder": str(tmp_path), "world": "lab"}, seed=3)
    for remount, code in enumerate("AAC"):
        bench.feed(EmulatedPhantom.mount, mount(code, remount))
    first, again, other = bench.sent(EmulatedPhantom.world_truth)
    heights = [given.height_offset_m for given in bench.sent(EmulatedPhantom.truth)]
    bench.executor.transition(Transition.SHUTDOWN)
    assert first.modulus == again.modulus != other.modulus
    assert first.friction != again.friction
    assert again.height_m - first.height_m == pytest.approx(heights[1] - heights[0])
