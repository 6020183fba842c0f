"""A stage that lies, or answers nothing at the worst moment, is stopped all the same."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.health import HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.stage import aerotech_link, aerotech_stop
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.stage.aerotech_motion import ControllerAxes, Leg, Motion
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop
from palp_core.palpation.devices.wire import aerotech as wire


class ScriptedPort:
    """A line on which the controller refuses NONE and answers every question with the same value."""

    def __init__(self, value: bytes) -> None:
        self.url, self.value, self.answers = "nowhere", value, b""

    def write(self, data: bytes) -> None:
        self.answers += b"!\n" if data.startswith(b"NONE") else b"%" + self.value + b"\n"

    def read_some(self) -> bytes:
        answers, self.answers = self.answers, b""
        return answers

    def close(self) -> None:
        pass


@pytest.mark.parametrize("value", [b"nan", b"inf", b"-Infinity", b"1e999"])
def test_a_position_that_is_no_number_is_garbled_and_never_a_place(
    monkeypatch: pytest.MonkeyPatch, value: bytes
) -> None:
    monkeypatch.setattr(aerotech_link, "SerialLink", lambda *_: ScriptedPort(value))
    link = AerotechLink("nowhere", 115200, 0.1)
    with pytest.raises(DeviceError, match="no number"):
        link.number("PFBKPROG(X)")
    assert link.garbled_count == 1


def motion_on(link: Any, watch: HealthMonitor) -> Motion:
    """Return the motion of two axes on a scripted link."""
    host = HostTime()
    return Motion(link, ControllerAxes(link, ("X", "Y"), host), host, watch, 50.0)


class DeafLink:
    """A link on which a move is taken, and somebody aborts before its answer, which may never come."""

    def __init__(self, *, answers: bool = False) -> None:
        self.sent: list[bytes] = []
        self.motion: Motion | None = None
        self.answers = answers

    def do(self, sent: bytes) -> None:
        assert self.motion is not None
        self.motion.abort()
        self.sent.append(sent)
        if not self.answers:
            raise DeviceTimeout("aerotech: no answer")

    def send_at_once(self, commands: bytes) -> None:
        self.sent.append(commands)


@pytest.mark.parametrize("answers", [True, False])
def test_a_move_that_is_taken_behind_an_abort_is_aborted_too(answers: bool) -> None:
    link = DeafLink(answers=answers)
    motion = motion_on(link, HealthMonitor(1.0))
    link.motion = motion
    with pytest.raises(DeviceError, match="stopped while a move began" if answers else "no answer"):
        motion.follow([Leg("X", 0.0, 80.0, 20.0, 0.080)])
    assert [words.split()[0] for words in link.sent] == [b"ABORT", b"MOVEABS", b"ABORT"]


class TakingLink:
    """A link on which everything is taken, and nothing ever ends."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def do(self, sent: bytes) -> None:
        self.sent.append(sent)

    send_at_once = do


def test_a_path_that_does_not_end_in_its_time_is_aborted_and_not_left_to_itself() -> None:
    link = TakingLink()
    motion = motion_on(link, HealthMonitor(1.0))
    motion.follow([Leg("X", 0.0, 80.0, 20.0, 0.080)])
    assert not motion.wait(0.001)
    assert [words.split()[0] for words in link.sent] == [b"MOVEABS", b"ABORT"]


class LyingLink:
    """The link of its own, whose answers break their reader."""

    def __init__(self) -> None:
        self.asked = threading.Event()

    def guard(self, axes: tuple[str, str]) -> bool:
        return True

    def require_guard(self) -> None:
        pass

    def bits(self, question: str) -> int:
        self.asked.set()
        raise ZeroDivisionError(question)

    def close(self) -> None:
        pass


def test_whatever_breaks_the_looks_at_the_axes_is_reported_and_does_not_end_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link = LyingLink()
    monkeypatch.setattr(aerotech_stop, "AerotechLink", lambda *_: link)
    stop = AerotechStop("nowhere", look_hz=1000.0)
    try:
        for _ in range(2):  # the thread goes on
            link.asked.clear()
            assert link.asked.wait(30.0)
            link.asked.clear()
            assert link.asked.wait(30.0)  # what was asked before has been answered by now
            with pytest.raises(DeviceError, match="ZeroDivisionError"):
                stop.reports()
    finally:
        stop.close()


class HealthyLink:
    """An axis at rest as a real controller reported it: bit 31, a level of the emergency stop, is set."""

    def require_guard(self) -> None:
        pass

    def number(self, question: str) -> float:
        return 0.0

    def bits(self, question: str) -> int:
        return wire.mask(b"-1791485433") if question.startswith("AXISSTATUS") else 0


def test_an_input_level_of_a_healthy_axis_is_no_emergency_stop() -> None:
    assert wire.mask(b"-1791485433") == 0x95381A07
    watch = HealthMonitor(1.0)
    motion = motion_on(HealthyLink(), watch)
    watch.note_data(HostTime().now_ns())
    for _ in range(4):
        motion._poll()
    assert watch.read(HostTime().now_ns()).ok
    assert not motion.busy
