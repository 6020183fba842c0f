"""Wires take their time, byte by byte in a time of the test; serve two clients; come back when plugged in."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices import open_device
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.emulator.faults import Faults
from palp_core.palpation.devices.emulator.netcanoem import Netcanoem, SocketCand
from palp_core.palpation.devices.emulator.ports import PtyPort
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.torque.ati import AtiState
from palp_core.palpation.devices.wire import aerotech
from tests.support.manual_reactor import ManualReactor

S = 1_000_000_000
ANSWER = b"y" * 50
Start = Callable[..., EmulatedRig]


class Answering:
    """A device that answers every byte string with the same fifty bytes."""

    greeting, ready_ns = b"", 0

    def __init__(self) -> None:
        self.heard_ns: list[int] = []

    def receive(self, data: bytes, now_ns: int) -> bytes:
        self.heard_ns.append(now_ns)
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
        assert device.heard_ns == []  # the last byte is still on its way
        loop.run_until(sent_ns + 1000)
        (heard_ns,) = device.heard_ns
        assert heard_ns == pytest.approx(sent_ns, abs=100)
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
    quick_rig: Start, wait: Any, patient: dict[str, dict[str, Any]]
) -> None:
    rig = quick_rig("ati")
    sensors = [open_device("torque", "ati", **rig.options["ati"], **patient["ati"]) for _ in range(2)]
    states = [AtiState() for _ in sensors]
    counts = [0, 0]

    def received(least: int) -> bool:
        for i, (sensor, state) in enumerate(zip(sensors, states, strict=True)):
            counts[i] += len(sensor.drain(time.monotonic_ns(), state, None).times_ns)  # type: ignore[arg-type]
        return min(counts) >= least

    for sensor, state in zip(sensors, states, strict=True):
        sensor.open(time.monotonic_ns(), state, None)  # type: ignore[arg-type]
    wait.until(lambda: received(20))
    rig.disconnect("ati")
    wait.until(lambda: all(str(s.health(time.monotonic_ns()).condition) == "link lost" for s in sensors))
    rig.connect("ati")
    before = max(counts)
    wait.until(lambda: received(before + 20))
    for sensor in sensors:
        sensor.close()
