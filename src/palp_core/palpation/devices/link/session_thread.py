"""A driver's thread, which holds a session with the device and begins another when it was lost."""

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar, Protocol

import numpy as np

from palp_core.errors import DeviceError
from palp_core.foreign import catch_foreign, describe_foreign
from palp_core.palpation.devices.health import Condition, DeviceHealth, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.unverified import warn_unverified


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


class SessionDriver:
    """Base of a sensor's driver: a thread holds the session with the device, and connects again by itself.

    A driver calls :meth:`_prepare` in its ``__post_init__``, and defines :meth:`_begin` and :meth:`_connect`.
    Its state has ``sample_count``, the samples numbered so far.
    """

    UNVERIFIED: ClassVar[dict[str, str]] = {}
    verified: tuple[str, ...] = ()

    def _prepare(self, name: str, stale_s: float) -> None:
        check_range(name, "stale_s", stale_s, 1e-3, 60.0)
        self._name, self._first = name, 0
        self._host, self._monitor = HostTime(), HealthMonitor(stale_s)
        self._receiver = SessionThread(name, self._connect, self._monitor, self._host)

    def _begin(self) -> None:
        """Forget what was received before; ``_first`` is the number of the next sample."""
        raise NotImplementedError

    def _connect(self) -> DeviceSession:
        """Begin a session, the first or another one after a lost link."""
        raise NotImplementedError

    def open(self, now_ns: int, state: Any, rng: np.random.Generator) -> None:
        """Connect and begin to receive."""
        self._receiver.refuse_if_running()
        self._host.observe(now_ns)
        warn_unverified(self._name, self.UNVERIFIED, self.verified)
        self._first = state.sample_count
        self._begin()
        self._receiver.start()

    def close(self) -> None:
        """End the thread and the session."""
        self._receiver.stop()

    def health(self, now_ns: int) -> DeviceHealth:
        """Return the present health."""
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())


def _close(session: DeviceSession) -> None:
    with suppress(Exception):
        session.close()
