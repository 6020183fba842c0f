"""A driver's thread outlives whatever its session raises, says what it was, and connects again."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from palp_core.errors import DeviceError
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


def test_an_error_that_nobody_foresaw_is_a_lost_link_by_name_and_not_the_end(wait: Any) -> None:
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
