"""One rig behind all wires: force follows stage and ring, wires take their time, two clients are served."""

from __future__ import annotations

import io
import json
import os
import select
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
from palp_core.palpation.devices.emulator.commands import serve
from palp_core.palpation.devices.emulator.contact import ContactSettings
from palp_core.palpation.devices.emulator.faults import Faults
from palp_core.palpation.devices.emulator.netcanoem import Netcanoem, SocketCand
from palp_core.palpation.devices.emulator.ports import PtyPort
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.torque import SimTorque
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.wire import aerotech
from palp_core.palpation.mechanics import Probe, contact_model, solve
from palp_core.palpation.mechanics.scene.phantom_file import PAPER_PHANTOMS
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.world.draws import open_world
from palp_core.palpation.world.model import LAB
from tests.support.manual_reactor import ManualReactor

LINK = "is not a folder of this user but a symbolic link"
S = 1_000_000_000
EXACT = SimRing(repeatability_m=0.0)


@pytest.mark.parametrize(("code", "ring_m", "y_m"), [("A", 0.016, 0.002), ("C", 0.004, -0.02)])
def test_the_emulated_torque_is_the_mechanics(code: str, ring_m: float, y_m: float) -> None:
    rig = EmulatedRig(RigSettings(contact=ContactSettings(code=code), ring=EXACT), devices=())
    rig.rod.move(ring_m + 0.001, 6.5e-3, 0)
    rig.axes.y.move(y_m, 0.05, 0)
    probe = Probe()
    model, _ = contact_model(PAPER_PHANTOMS[code], probe.tip_radius_m, indentation_m=0.004)
    table = solve(model, probe, ring_m, 0.004, -0.032, 0.052)
    assert rig.contact.loads(60 * S)[2] == pytest.approx(float(table.torque_n_m(y_m)), abs=1e-8)
    rig.axes.z.move(0.02, 0.05, 60 * S)
    assert rig.contact.loads(120 * S) == [0.0] * 3
    rig.contact.close()


def test_the_emulated_torque_in_a_world_is_that_worlds() -> None:
    """Sweeping on and back: the joint lags the other way, and starts where the probe was lowered."""
    touched = ContactSettings(code="A", world=LAB, lands_m=(-0.03, 0.05))
    walking = SimTorque(bias_drift_n_m_per_sqrt_s=LAB.bias_walk_n_m_per_sqrt_s)
    rig = EmulatedRig(RigSettings(contact=touched, ring=EXACT, torque=walking), devices=())
    rig.rod.move(0.017, 6.5e-3, 0)
    sweeps = open_world(rig.contact.rig, LAB, 1, -0.032, 0.052).sweeps("A", 1, 0.016, 0.0, 0.0)
    there, back = (sweeps.of(at_m, 1, 0.02, forward=at_m < 0.0) for at_m in (-0.03, 0.05))
    now_ns = 60 * S
    for goal_m, known in ((0.003, there), (-0.003, back)):
        rig.axes.y.move(goal_m - (0.001 if known is there else -0.001), 0.05, now_ns)
        rig.contact.loads(now_ns + 30 * S)
        rig.axes.y.move(goal_m, 0.05, now_ns + 30 * S)
        now_ns += 60 * S
        torque = rig.contact.loads(now_ns)[2]
        assert torque == pytest.approx(float(known.torque_n_m(np.array([goal_m]))[0]), abs=1e-6)
    zero = [rig.sensor.wrench(now_ns + k * 1000 * S)[3] for k in range(1, 60)]
    rig.contact.close()
    assert np.std(zero) > 3 * RESOLUTION_N_M


def test_terminals_are_laid_in_no_folder_that_a_link_leads_to(tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    (tmp_path / "ours").symlink_to(tmp_path / "theirs")
    rig = EmulatedRig(RigSettings(folder=str(tmp_path / "ours")), ("maestro",))
    with pytest.raises(DeviceError, match=f"{tmp_path}/ours {LINK}; choose another folder"):
        rig.start()
    assert list((tmp_path / "theirs").iterdir()) == []
    rig = EmulatedRig(RigSettings(folder=str(tmp_path / "theirs" / "new")), ("maestro",))
    with rig:
        assert (tmp_path / "theirs" / "new").stat().st_mode & 0o777 == 0o700
        assert (tmp_path / "theirs" / "new" / "maestro").is_symlink()


def test_what_the_sensors_driver_reads_follows_the_stages_and_the_rings_drivers(
    quick_rig: Callable[..., EmulatedRig], driver: Callable[..., Subject]
) -> None:
    rig = quick_rig("aerotech", "maestro", "ati")
    stage, ring, sensor = driver(rig, "aerotech", lift_m=0.005), driver(rig, "maestro"), driver(rig, "ati")

    def block_of(duration_ns: int) -> Any:
        begin_ns, blocks = sensor.now(), []

        def whole() -> bool:
            blocks.append(sensor.call("drain"))
            return bool(np.any(blocks[-1].times_ns >= begin_ns + duration_ns))

        sensor.until(whole, "samples")  # a busy receiver hands over late what was measured before
        fresh = [block.times_ns >= begin_ns for block in blocks]
        torque_n_m = np.concatenate([b.torque_n_m[of] for b, of in zip(blocks, fresh, strict=True)])
        wrench = np.concatenate([b.wrench[of] for b, of in zip(blocks, fresh, strict=True)])
        return replace(blocks[-1], torque_n_m=torque_n_m, wrench=wrench)

    sensor.device.tare(block_of(S // 4), sensor.state)  # raised: nothing touches the probe
    seen = []
    for ring_m in (0.001, 0.004):
        ring.call("command", ring_m)
        ring.until(lambda: ring.call("read").settled, "it to settle")
        stage.move("return_to", 0.0)
        truth = rig.call(rig.truth)
        assert block_of(S // 4).torque_n_m.mean() == pytest.approx(truth["torque_n_m"], abs=15e-6)
        seen.append(truth["torque_n_m"])
    assert seen[1] > 1.5 * seen[0] > 0.0


def test_the_rigs_process_obeys_and_answers_every_line(quick_rig: Callable[..., EmulatedRig]) -> None:
    rig, out = quick_rig("ati"), io.StringIO()
    lines = ["fault ati saturated", "clear ati", "mount B 0.1", "truth", "", "fault ati fire", "dance"]
    serve(rig, [*lines, "quit", "truth"], out)
    answers = out.getvalue().splitlines()
    assert answers[:3] == ["ok"] * 3
    assert json.loads(answers[3])["torque_n_m"] != 0.0
    assert "no fault 'fire'" in answers[4]
    assert answers[5].startswith("error: 'dance' is not a command")
    assert len(answers) == 6


def test_an_unknown_device_or_phantom_is_refused_by_name(quick_rig: Callable[..., EmulatedRig]) -> None:
    with pytest.raises(DeviceError, match="no device gripper"):
        EmulatedRig(devices=["gripper"])
    rig = quick_rig("maestro")
    with pytest.raises(DeviceError, match="no phantom 'Z'"):
        rig.call(lambda _: rig.contact.mount("Z", 0.0))
    with pytest.raises(DeviceError, match="there are maestro"):
        rig.fault("ati", "silence")


ANSWER = b"y" * 50
Start = Callable[..., EmulatedRig]


class Answering:
    """A device that answers every byte string with the same fifty bytes."""

    greeting, ready_ns = b"", 0

    def __init__(self) -> None:
        self.received_ns: list[int] = []

    def receive(self, data: bytes, now_ns: int) -> bytes:
        self.received_ns.append(now_ns)
        return ANSWER


def readable(descriptor: int, timeout_s: float) -> bool:
    return bool(select.select([descriptor], [], [], timeout_s)[0])


@pytest.mark.parametrize("baud", [9600, 115200, 230400])
def test_a_terminal_takes_ten_bits_for_every_byte_both_ways(tmp_path: Path, baud: int) -> None:
    loop, device = ManualReactor(), Answering()
    port = PtyPort(loop, tmp_path / "tty", lambda: device, Faults(), baud)
    port.plug()
    (far_end,) = (key for key in loop.readers() if isinstance(key, int))
    near_end = os.open(port.address, os.O_RDWR | os.O_NOCTTY)
    sent_ns, answered_ns = 20 * 10 * S // baud, 50 * 10 * S // baud
    try:
        os.write(near_end, b"x" * 20)
        assert readable(far_end, 120.0)
        loop.run_until(sent_ns - 1000)
        assert device.received_ns == []  # the last byte is still on its way
        loop.run_until(sent_ns + 1000)
        (received_ns,) = device.received_ns
        assert received_ns == pytest.approx(sent_ns, abs=100)
        loop.run_until(sent_ns + answered_ns - 1000)
        assert not readable(near_end, 0.0)
        loop.run_until(sent_ns + answered_ns + 1000)
        assert readable(near_end, 120.0)
        assert os.read(near_end, 100) == ANSWER
    finally:
        os.close(near_end)
        port.unplug()


@pytest.mark.parametrize(("bitrate", "low", "high"), [(250_000, 800, 1000), (500_000, 1600, 2000)])
def test_a_bus_carries_no_more_samples_than_its_bits(bitrate: int, low: float, high: float) -> None:
    server, now_ns = SocketCand(Netcanoem(lambda _: [0.0] * 6), bitrate), 0
    for _ in range(500):
        server.receive(b"< send 200 0  >", now_ns)
        now_ns = server.ready_ns
    assert low < 500 * S / now_ns < high


def test_two_clients_of_the_stage_command_the_same_axes_and_both_come_back(quick_rig: Start) -> None:
    rig = quick_rig("aerotech")
    for _ in range(2):
        one, two = (AerotechLink(rig.addresses["aerotech"], 115200, 30.0) for _ in range(2))
        one.do(aerotech.command("ENABLE X"))
        assert two.bits("AXISSTATUS(X)") & aerotech.AxisStatus.ENABLED
        two.do(aerotech.command("DISABLE X"))
        assert not one.bits("AXISSTATUS(X)") & aerotech.AxisStatus.ENABLED
        rig.disconnect("aerotech")
        for link in (one, two):
            with pytest.raises(DeviceError, match="lost"):
                link.bits("AXISSTATUS(X)")
            link.close()
        rig.connect("aerotech")


def test_two_clients_of_the_bus_are_both_served_and_both_come_back(
    quick_rig: Start, driver: Callable[..., Subject]
) -> None:
    rig = quick_rig("ati")
    sensors = [driver(rig, "ati") for _ in range(2)]
    counts = [0, 0]

    def received(least: int) -> bool:
        for i, sensor in enumerate(sensors):
            counts[i] += len(sensor.call("drain").times_ns)
        return min(counts) >= least

    def lost(sensor: Subject) -> bool:
        return bool(sensor.device.health(sensor.now()).condition == "link lost")

    sensors[0].until(lambda: received(20), "samples")
    rig.disconnect("ati")
    sensors[0].until(lambda: all(map(lost, sensors)), "lost links")
    rig.connect("ati")
    before = max(counts)
    sensors[0].until(lambda: received(before + 20), "samples again")
