"""A driver's thread outlives whatever its session or a library raises, reports it, and connects again."""

from __future__ import annotations

import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.emg.lsl import LslEmg
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.session_thread import SessionThread


class Odd:
    """A session that fails as no driver foresaw, both in its step and in being closed."""

    def step(self, stop: threading.Event) -> None:
        raise ZeroDivisionError("odd")

    def close(self) -> None:
        raise ZeroDivisionError("odd again")


class Good:
    """A session in which nothing happens."""

    def __init__(self, watch: HealthMonitor) -> None:
        self.watch = watch

    def step(self, stop: threading.Event) -> None:
        self.watch.note_data(1)
        stop.wait(0.01)

    def close(self) -> None:
        pass


def test_an_unforeseen_error_is_a_lost_link_by_name_and_not_the_end(wait: Any) -> None:
    watch, shown = HealthMonitor(0.0), list[str]()
    report = watch.report

    def note(condition: Condition, now_ns: int, cause: str = "") -> None:
        shown.append(f"{condition}: {cause}")
        report(condition, now_ns, cause)

    watch.report = note  # type: ignore[method-assign]
    sessions: list[Any] = [Good(watch), Odd()]
    receiver = SessionThread("odd", lambda: sessions.pop(), watch, HostTime(), retry_s=0.0)
    receiver.start()
    wait.until(lambda: not sessions and watch.read(2).ok)
    receiver.stop()
    assert "link lost: odd: ZeroDivisionError: odd" in shown
    assert receiver.lost_count == 1


@pytest.mark.parametrize(
    ("raised", "shown"),
    [
        (NameError("canlib"), "odd: cannot connect: NameError: canlib; check address and cable"),
        (OSError(113, "No route to host"), "odd: cannot connect: No route to host; check address and cable"),
        (DeviceError("odd: no answer; is it on?"), "odd: no answer; is it on?"),
    ],
)
def test_whatever_a_library_raises_at_the_first_session_is_a_device_error(
    raised: Exception, shown: str
) -> None:
    def connect() -> Any:
        raise raised

    with pytest.raises(DeviceError) as seen:
        SessionThread("odd", connect, HealthMonitor(1.0), HostTime()).start()
    assert str(seen.value) == shown


class GoneInlet:
    """The inlet of a stream that was withdrawn right after it was found."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def info(self, timeout: float) -> Any:
        raise RuntimeError("the operation failed due to a timeout.")


def test_a_stream_that_goes_while_it_is_opened_is_a_device_error(monkeypatch: pytest.MonkeyPatch) -> None:
    found = SimpleNamespace(nominal_srate=lambda: 1500.0, channel_count=lambda: 2)
    fake = SimpleNamespace(resolve_byprop=lambda *_: [found], StreamInlet=GoneInlet)
    monkeypatch.setitem(sys.modules, "pylsl", fake)
    source = LslEmg("band")
    with pytest.raises(DeviceError, match="'band' was found but does not open"):
        source.open(time.monotonic_ns(), EmgSourceState(), np.random.default_rng(0))
