"""The protocols' transcripts, byte by byte: the same tables drive the emulators and the drivers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.emg.noraxon import NoraxonEmg
from palp_core.palpation.devices.emulator.aerotech import Aerotech
from palp_core.palpation.devices.emulator.axis import Axes, Axis, AxisSettings
from palp_core.palpation.devices.emulator.emg import Http, Noraxon
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import Faults
from palp_core.palpation.devices.emulator.maestro import EmulatedRod, Maestro, MaestroSettings
from palp_core.palpation.devices.emulator.netcanoem import Netcanoem, SocketCand
from palp_core.palpation.devices.emulator.ports import DeviceSide, TcpPort
from palp_core.palpation.devices.ring.maestro_link import MaestroLink
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink, CommandRefused
from palp_core.palpation.devices.torque.ati import AtiState, AtiTorque
from palp_core.palpation.devices.wire import aerotech, maestro

S = 1_000_000_000
UNLOADED = [0.0] * 6


@dataclass
class Script:
    """A device that knows its part by heart, and refuses any other cue."""

    part: list[tuple[bytes, bytes]]
    greeting: bytes = b""
    ready_ns: int = 0
    received: list[bytes] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def receive(self, data: bytes, now_ns: int) -> bytes:
        reply = b""
        while data:
            if not self.part:
                self.wrong.append(f"{data!r} after the end")
                return reply
            cue, answer = self.part[0]
            if not data.startswith(cue):
                self.wrong.append(f"{data!r} instead of {cue!r}")
                return reply
            self.part.pop(0)
            data = data[len(cue) :]
            reply += answer
        return reply


@pytest.fixture
def loop() -> Iterator[EmulatorLoop]:
    loop = EmulatorLoop()
    yield loop
    failures = loop.failures
    loop.stop()
    assert failures == []


@pytest.fixture
def axes() -> Axes:
    return Axes(Axis(AxisSettings()), Axis(AxisSettings(soft_low_m=-0.001)))


@pytest.fixture
def rod() -> EmulatedRod:
    return EmulatedRod(SimRing(repeatability_m=0.0), seed=1)


def listen(loop: EmulatorLoop, make: Callable[[], DeviceSide]) -> TcpPort:
    port = TcpPort(loop, 0, make, Faults())
    loop.call(port.plug)
    return port


# Aerotech: time in s, what the host sends, what the controller answers, and how the driver says it.
STAGE: list[tuple[float, bytes, bytes, Callable[[AerotechLink], object], object]] = [
    (0.0, b"AXISFAULT(@0)\n", b"%0\n", lambda link: link.bits("AXISFAULT(@0)"), 0),
    (0.0, b"ENABLE @0\n", b"%\n", lambda link: link.do(aerotech.command("ENABLE @0")), None),
    (0.0, b"WAIT MODE NOWAIT\n", b"%\n", lambda link: link.do(aerotech.command("WAIT MODE NOWAIT")), None),
    (0.0, b"HOMEASYNC @0\n", b"%\n", lambda link: link.do(aerotech.command("HOMEASYNC @0")), None),
    (0.1, b"AXISSTATUS(@0)\n", b"%16393\n", lambda link: link.bits("AXISSTATUS(@0)"), 16393),
    (1.0, b"AXISSTATUS(@0)\n", b"%7\n", lambda link: link.bits("AXISSTATUS(@0)"), 7),
    (2.0, b"MOVEABS X 10.000 XF 20.000\n", b"%\n", lambda link: link.do(aerotech.move("X", 10, 20)), None),
    (2.001, b"AXISSTATUS(X)\n", b"%539\n", lambda link: link.bits("AXISSTATUS(X)"), 539),
    (2.1, b"AXISSTATUS(X)\n", b"%523\n", lambda link: link.bits("AXISSTATUS(X)"), 523),
    (2.2208, b"PFBKPROG(X)\n", b"%4.216\n", lambda link: link.number("PFBKPROG(X)"), 4.216),
    (2.3, b"PLANESTATUS(0)\n", b"%1\n", lambda link: link.bits("PLANESTATUS(0)"), 1),
    (4.0, b"PLANESTATUS(0)\n", b"%0\n", lambda link: link.bits("PLANESTATUS(0)"), 0),
]
BEYOND = [
    (5.0, b"MOVEABS X 99.000 XF 20.000\n", b"#\n"),
    (5.0, b"AXISFAULT(X)\n", b"%16\n"),
]
E_STOP = [
    (6.0, b"AXISFAULT(X)\n", b"%2048\n"),
    (6.0, b"AXISSTATUS(X)\n", b"%-2147483646\n"),
    (6.0, b"ENABLE X\n", b"#\n"),
]


def test_the_stages_emulator_answers_the_transcript(axes: Axes) -> None:
    controller = Aerotech(axes)
    assert controller.receive(b"NONE\n", 0) == b"!\n"
    for at_s, sent, answer, _, _ in STAGE:
        assert controller.receive(sent, round(at_s * S)) == answer, sent
    for at_s, sent, answer in BEYOND:
        assert controller.receive(sent, round(at_s * S)) == answer, sent
    assert controller.receive(b"FAULTACK X\nENABLE X\n", 5 * S) == b"%\n%\n"


def test_the_stages_emulator_reports_an_emergency_stop_as_the_transcript_does(axes: Axes) -> None:
    controller, axis = Aerotech(axes), axes.y
    controller.receive(b"ENABLE X\nHOMEASYNC X\nAXISSTATUS(X)\n", 0)
    controller.receive(b"AXISSTATUS(X)\n", 5 * S)
    axis.estop = True
    axis.trip(aerotech.Fault.E_STOP, 5 * S)
    for at_s, sent, answer in E_STOP:
        assert controller.receive(sent, round(at_s * S)) == answer, sent
    axis.estop = False
    assert controller.receive(b"ENABLE X\n", 7 * S) == b"#\n"
    assert controller.receive(b"FAULTACK X\n", 7 * S) == b"%\n"
    assert controller.receive(b"ENABLE X\n", 7 * S) == b"%\n"


def test_an_emulator_set_to_accept_and_fault_accepts_and_faults(axes: Axes) -> None:
    controller = Aerotech(axes, refuses_beyond=False)
    controller.receive(b"ENABLE X\n", 0)
    assert controller.receive(b"MOVEABS X 99.000 XF 20\n", 0) == b"%\n"
    assert controller.receive(b"AXISFAULT(X)\n", 0) == b"%16\n"


@pytest.mark.parametrize("always_end", [True, False])
def test_the_stages_driver_says_and_understands_the_transcript(loop: EmulatorLoop, always_end: bool) -> None:
    def ending(answer: bytes) -> bytes:
        return answer if always_end or len(answer) > 2 else answer[:1]

    script = Script(
        [(b"NONE\n", ending(b"!\n")), *((sent, ending(answer)) for _, sent, answer, _, _ in STAGE)]
    )
    port = listen(loop, lambda: script)
    link = AerotechLink(port.address, 115200, 30.0)
    for _, sent, _, say, expected in STAGE:
        assert say(link) == expected, sent
    link.close()
    loop.call(port.unplug)
    assert (script.wrong, script.part) == ([], [])


def test_the_stages_driver_understands_limits_and_the_emergency_stop(loop: EmulatorLoop) -> None:
    script = Script([(b"NONE\n", b"!\n"), *((sent, answer) for _, sent, answer in [*BEYOND, *E_STOP])])
    port = listen(loop, lambda: script)
    link = AerotechLink(port.address, 115200, 30.0)
    with pytest.raises(CommandRefused, match="could not be executed"):
        link.do(aerotech.move("X", 99.0, 20.0))
    assert aerotech.Fault(link.bits("AXISFAULT(X)")).words == "cw soft limit"
    assert aerotech.Fault(link.bits("AXISFAULT(X)")) is aerotech.Fault.E_STOP
    assert link.bits("AXISSTATUS(X)") == 0x80000002
    with pytest.raises(CommandRefused):
        link.do(aerotech.command("ENABLE X"))
    link.close()
    loop.call(port.unplug)
    assert (script.wrong, script.part) == ([], [])


def test_a_fault_without_a_name_is_reported_by_its_bit() -> None:
    assert aerotech.Fault(1 << 13 | 1).words == "position error, bit 13"
    assert aerotech.Fault(0).words == "none"


def test_a_bare_acknowledgement_is_one_byte_when_ends_are_off(axes: Axes) -> None:
    controller = Aerotech(axes, always_end=False)
    assert controller.receive(bytes.fromhex("454E41424C452040300A"), 0) == bytes.fromhex("25")
    axes.y.home(0)
    controller.receive(b"AXISSTATUS(X)\nMOVEABS X 10.000 XF 20.000\n", S)
    at_ns = S + round(0.2208 * S)
    assert controller.receive(bytes.fromhex("50464B50"), at_ns) == b""  # half a question
    assert Aerotech(axes).receive(bytes.fromhex("5046424B50524F472858290A"), at_ns) == bytes.fromhex(
        "25342E3231360A"
    )


# Maestro: time in s, command, check byte, answer, and how the driver says it.
RING: list[tuple[float, str, str, str, Callable[[MaestroLink], object], object]] = [
    (0.0, "87 00 05 00", "04", "", lambda link: link.command(maestro.set_speed(0, 5)), None),
    (0.0, "84 00 20 1F", "48", "", lambda link: link.command(maestro.set_target(0, 4000)), None),
    (0.1, "90 00", "65", "A0 0F", lambda link: link.position(0), 4000),
    (0.1, "84 00 20 24", "4D", "", lambda link: link.command(maestro.set_target(0, 4640)), None),
    (0.2, "93", "13", "01", lambda link: link.ask(b"\x93", 1), 1),
    (9.0, "93", "13", "00", lambda link: link.ask(b"\x93", 1), 0),
    (9.0, "84 00 20 29", "66", "", lambda link: link.command(maestro.set_target(0, 5280)), None),
    (19.0, "90 00", "65", "A0 14", lambda link: link.position(0), 5280),
    (19.0, "90 01", "-", "D8 00", lambda link: link.position(1), 216),
    (19.0, "84 00 70 2E", "2B", "", lambda link: link.command(maestro.set_target(0, 6000)), None),
    (29.0, "90 00", "65", "70 17", lambda link: link.position(0), 6000),
    (29.0, "90 01", "-", "52 01", lambda link: link.position(1), 338),
    (29.0, "84 00 40 3E", "35", "", lambda link: link.command(maestro.set_target(0, 8000)), None),
    (49.0, "90 00", "65", "40 1F", lambda link: link.position(0), 8000),
    (49.0, "90 01", "-", "A3 02", lambda link: link.position(1), 675),
    (49.0, "A1", "1B", "00 00", lambda link: link.errors(), maestro.Error(0)),
    (49.0, "A2", "49", "", lambda link: link.command(b"\xa2"), None),
    (49.0, "A1", "1B", "00 00", lambda link: link.errors(), maestro.Error(0)),
]


def sent_bytes(message: str, check: str, crc: bool) -> bytes:
    plain = bytes.fromhex(message)
    if not crc:
        return plain
    return maestro.with_crc(plain) if check == "-" else plain + bytes.fromhex(check)


@pytest.mark.parametrize("crc", [True, False])
def test_the_rings_emulator_answers_the_transcript(rod: EmulatedRod, crc: bool) -> None:
    controller = Maestro(rod, MaestroSettings(crc=crc))
    for at_s, message, check, answer, _, _ in RING:
        reply = controller.receive(sent_bytes(message, check, crc), round(at_s * S))
        assert reply == bytes.fromhex(answer), (at_s, message)


@pytest.mark.parametrize("crc", [True, False])
def test_the_rings_driver_says_and_understands_the_transcript(loop: EmulatorLoop, crc: bool) -> None:
    script = Script([(sent_bytes(m, c, crc), bytes.fromhex(a)) for _, m, c, a, _, _ in RING])
    port = listen(loop, lambda: script)
    link = MaestroLink(port.address, crc, 30.0)
    for _, message, _, _, say, expected in RING:
        assert say(link) == expected, message
    link.close()
    loop.call(port.unplug)
    assert (script.wrong, script.part) == ([], [])


def test_the_pololu_form_means_the_same_as_the_compact_one(rod: EmulatedRod) -> None:
    controller = Maestro(rod, MaestroSettings())
    assert controller.receive(bytes.fromhex("AA 0C 04 00 20 29 6F"), 0) == b""
    assert controller.receive(bytes.fromhex("90 00 65"), S) == bytes.fromhex("A0 14")


def test_a_wrong_check_byte_moves_nothing_and_is_reported_once(rod: EmulatedRod) -> None:
    controller = Maestro(rod, MaestroSettings())
    before = controller.receive(bytes.fromhex("90 00 65"), 0)
    controller.receive(bytes.fromhex("84 00 20 29 00"), 0)
    assert controller.receive(bytes.fromhex("90 00 65"), 9 * S) == before
    assert controller.receive(bytes.fromhex("A1 1B"), 9 * S) == bytes.fromhex("08 00")
    assert controller.receive(bytes.fromhex("A1 1B"), 9 * S) == bytes.fromhex("00 00")


def test_a_silent_host_stops_the_ring_and_is_reported(rod: EmulatedRod) -> None:
    controller = Maestro(rod, MaestroSettings(timeout_s=0.5))
    controller.receive(bytes.fromhex("87 00 01 00") + bytes([maestro.crc7(bytes.fromhex("87000100"))]), 0)
    controller.receive(bytes.fromhex("84 00 40 3E 35"), 0)
    assert controller.receive(bytes.fromhex("A1 1B"), S) == bytes.fromhex("20 00")
    at_us = int.from_bytes(controller.receive(bytes.fromhex("90 00 65"), 9 * S), "little") / 4
    assert at_us == pytest.approx(1000.0 + 25.0, abs=1.0)  # where it was after a second at 25 us/s


SENSOR = {
    "206#00": ["206#00"],
    "207#": ["207#000F4240000F4240"],
    "208#": ["208#0204"],
    "20F#": ["20F#03080001"],
    "202#00": ["202#BFB2E800C03F3600", "203#413FCC00C3F1502C", "204#C101718043EFBC44"],
    "202#03": ["202#41458F0045746E12", "203#454CD862C4E49724", "204#C54B4B43C4C8A4F1"],
    "200#": ["200#00000064012C01F4", "201#FF38FE70FDA8"],
}
SUPPLY_LOW = ["200#80200064012C01F4", "201#FF38FE70FDA8"]
SATURATED = ["200#00007FFF012C01F4", "201#FF38FE70FDA8"]
GAUGES = (100, -200, 300, -400, 500, -600)
WRENCH = (-0.094623, 0.154854, 0.531997, 0.270546e-3, 1.798777e-3, -2.893299e-3)


def frame(text: str) -> tuple[int, bytes]:
    identifier, _, data = text.partition("#")
    return int(identifier, 16), bytes.fromhex(data)


def test_the_sensors_emulator_answers_the_transcript() -> None:
    sensor = Netcanoem(lambda _: UNLOADED, gauges=GAUGES)
    for request, answers in SENSOR.items():
        assert sensor.answer(*frame(request), 0) == [frame(answer) for answer in answers], request
    sensor.status = 0x8020
    assert sensor.answer(0x200, b"", 0) == [frame(answer) for answer in SUPPLY_LOW]
    sensor.status, sensor.saturated = 0, (0,)
    assert sensor.answer(0x200, b"", 0) == [frame(answer) for answer in SATURATED]
    assert sensor.answer(0x300, b"", 0) == []


def test_socketcand_speaks_as_the_transcript_does() -> None:
    server = SocketCand(Netcanoem(lambda _: UNLOADED, gauges=GAUGES), 500_000)
    assert server.greeting == b"< hi >"
    assert server.receive(b"< open can0 >", 0) == b"< ok >"
    assert server.receive(b"< rawmode >", 0) == b"< ok >"
    reply = server.receive(b"< send 200 0  >", 1_234_567_000)
    assert reply == b"< frame 200 1.234567 00000064012C01F4 >< frame 201 1.234567 FF38FE70FDA8 >"
    assert 400_000 < server.ready_ns - 1_234_567_000 < 620_000  # 253 to 305 bits at 500 kbit/s


class KnownSensor(Netcanoem):
    """A sensor that answers from the table, and from its own matrix where the table is silent."""

    def __init__(self, sample: list[str]) -> None:
        super().__init__(lambda _: UNLOADED, gauges=GAUGES)
        self._table: dict[tuple[int, bytes], list[str]] = {frame(r): a for r, a in SENSOR.items()}
        self._table[frame("200#")] = sample

    def answer(self, identifier: int, data: bytes, now_ns: int) -> list[tuple[int, bytes]]:
        known = self._table.get((identifier, data))
        return [frame(a) for a in known] if known else super().answer(identifier, data, now_ns)


def first_sample(loop: EmulatorLoop, sample: list[str]) -> Any:
    port = listen(loop, lambda: SocketCand(KnownSensor(sample), 0))
    link = {"host": port.host, "port": port.port, "tcp_tune": True}
    sensor = AtiTorque(interface="socketcand", options=link, rate_hz=100.0, timeout_s=30.0, verified=("*",))
    state, rng = AtiState(), np.random.default_rng(0)
    sensor.open(0, state, rng)
    try:
        while True:
            block = sensor.drain(0, state, rng)
            if len(block.times_ns):
                return block
    finally:
        sensor.close()
        loop.call(port.unplug)


def test_the_sensors_driver_makes_forces_of_the_transcript(loop: EmulatorLoop) -> None:
    block = first_sample(loop, SENSOR["200#"])
    np.testing.assert_allclose(block.wrench[0], WRENCH, atol=1e-6)
    assert block.torque_n_m[0] == pytest.approx(WRENCH[3], abs=1e-9)
    assert not block.faulty[0]


@pytest.mark.parametrize(("sample", "saturated"), [(SUPPLY_LOW, 0), (SATURATED, 1)])
def test_the_sensors_driver_does_not_trust_a_bad_sample(
    loop: EmulatorLoop, sample: list[str], saturated: int
) -> None:
    block = first_sample(loop, sample)
    assert bool(block.faulty[0])
    assert min(block.saturated_count, 1) == saturated
    assert abs(block.torque_n_m[0]) <= 0.120


HEADERS = {
    "headers": [
        {"name": "FDS", "type": "real.emg", "samplerate": 1500, "units": "uV", "index": 0},
        {"name": "EDC", "type": "real.emg", "samplerate": 1500, "units": "uV", "index": 1},
    ]
}


def test_noraxons_emulator_answers_the_transcript() -> None:
    amplifier = Noraxon()
    assert json.loads(amplifier.page("/headers", 0) or b"") == HEADERS
    for path in ("/disable/all", "/enable/0", "/enable/1"):
        assert amplifier.page(path, 0) == b""
    amplifier.page("/samples", 0)
    (fds, edc) = json.loads(amplifier.page("/samples", S // 50) or b"")["channels"]
    assert (fds["index"], edc["index"]) == (0, 1)
    assert len(fds["samples"]) == len(edc["samples"]) == 30


def test_noraxons_driver_understands_the_transcript(loop: EmulatorLoop) -> None:
    asked: list[str] = []

    def page(path: str, now_ns: int) -> bytes:
        asked.append(path)
        if path == "/headers":
            return json.dumps(HEADERS).encode()
        if path != "/samples" or asked.count("/samples") != 2:
            return (
                b'{"channels":[{"index":0,"samples":[]},{"index":1,"samples":[]}]}'
                if path == "/samples"
                else b""
            )
        return b'{"channels":[{"index":0,"samples":[1.5,-2.0]},{"index":1,"samples":[3.0,4.0]}]}'

    port = listen(loop, lambda: Http(page, "application/json"))
    source = NoraxonEmg(port.host, port.port, timeout_s=30.0, verified=("*",))
    state, rng = EmgSourceState(), np.random.default_rng(0)
    source.open(0, state, rng)
    block = source.drain(0, state, rng)
    while not len(block.times_ns):
        block = source.drain(0, state, rng)
    source.close()
    loop.call(port.unplug)
    assert asked[:5] == ["/headers", "/disable/all", "/enable/0", "/enable/1", "/samples"]
    np.testing.assert_allclose(block.fds_v, [1.5e-6, -2e-6])
    np.testing.assert_allclose(block.edc_v, [3e-6, 4e-6])
