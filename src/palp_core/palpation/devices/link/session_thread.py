"""A driver's thread: hold a session with the device, and take it up again when it was lost."""

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from palp_core.errors import DeviceError
from palp_core.foreign import catch_foreign, describe_foreign
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime


class DeviceSession(Protocol):
    """One connection to a device, used by one thread."""

    def step(self, stop: threading.Event) -> None:
        """Receive or exchange once, for at most a fraction of a second."""

    def close(self) -> None: ...


class SessionThread:
    """Run sessions in a thread until stopped.

    The first session is begun by the caller, so that a wrong address is an error where it was given. Later
    ones are begun by the thread every ``retry_s``: a sensor may come back by itself, as nothing moves by it.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], DeviceSession],
        monitor: HealthMonitor,
        host: HostTime,
        retry_s: float = 0.1,
    ) -> None:
        self._name, self._connect, self._retry_s = name, connect, retry_s
        self._monitor, self._host = monitor, host
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.lost_count = 0

    def start(self) -> None:
        """Begin the first session and the thread."""
        self.refuse_if_running()
        session = self._begin()
        self._monitor.note_data(self._host.now_ns())
        self._stop.clear()
        self._thread = threading.Thread(
            target=self._run, args=(session,), name=f"palp-{self._name}", daemon=True
        )
        self._thread.start()

    def refuse_if_running(self) -> None:
        """Refuse to be opened twice, before anything is changed."""
        if self._thread is not None:
            raise DeviceError(f"{self._name}: open already; close it first")

    def stop(self) -> None:
        """End thread and session."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None
        self._monitor.report(Condition.CLOSED, self._host.now_ns())

    def _begin(self) -> DeviceSession:
        with catch_foreign(f"{self._name}: cannot connect", DeviceError, "check address and cable"):
            return self._connect()

    def _run(self, session: DeviceSession | None) -> None:
        while not self._stop.is_set():
            try:
                if session is None:
                    session = self._begin()
                session.step(self._stop)
            except Exception as error:  # noqa: BLE001 - or the thread would end without a report
                if session is not None:
                    self.lost_count += 1
                    _close(session)
                    session = None
                known = isinstance(error, DeviceError)
                cause = str(error) if known else f"{self._name}: {describe_foreign(error)}"
                self._monitor.report(Condition.LINK_LOST, self._host.now_ns(), cause)
                self._stop.wait(self._retry_s)
        if session is not None:
            _close(session)


def _close(session: DeviceSession) -> None:
    with suppress(Exception):
        session.close()
