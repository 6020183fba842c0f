"""What the EMG drivers have in common: a sample line, a health monitor and a thread."""

from typing import ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import DeviceHealth, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.link.session_thread import DeviceSession, SessionThread
from palp_core.palpation.devices.protocols import EmgSamples


class EmgSourceState(msgspec.Struct):
    """What outlives the driver: how many samples were numbered."""

    sample_count: int = 0


class EmgDriver:
    """Base of the drivers: receive two muscles in volts, in a thread that connects again by itself.

    A driver calls :meth:`_receive` in its ``__post_init__`` and defines :meth:`_connect`.
    """

    state_type: ClassVar[type[EmgSourceState]] = EmgSourceState

    def _receive(self, name: str, rate_hz: float, stale_s: float) -> None:
        """Make the thread and what it reports to."""
        check_range(name, "rate_hz", rate_hz, 1.0, 1e5)
        check_range(name, "stale_s", stale_s, 1e-3, 60.0)
        self._name = name
        self._host, self._monitor = HostTime(), HealthMonitor(stale_s)
        self._line: SampleLine | None = None
        self._line_hz, self._first = rate_hz, 0
        self._receiver = SessionThread(name, self._begin_session, self._monitor, self._host)

    def _connect(self, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> DeviceSession:
        """Begin a session that appends to ``line``."""
        raise NotImplementedError

    def open(self, now_ns: int, state: EmgSourceState, rng: np.random.Generator) -> None:
        """Connect and begin to receive."""
        self._receiver.refuse_if_running()
        self._host.observe(now_ns)
        self._line, self._first = SampleLine(self._line_hz, 2), state.sample_count
        self._receiver.start()

    def close(self) -> None:
        """Disconnect."""
        self._receiver.stop()

    def health(self, now_ns: int) -> DeviceHealth:
        """Return the present health."""
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())

    def drain(self, now_ns: int, state: EmgSourceState, rng: np.random.Generator) -> EmgSamples:
        """Return every sample received since the last call."""
        self._host.observe(now_ns)
        if self._line is None:
            raise DeviceError(f"{self._name}: not open; open it first")
        stretch = self._line.drain()
        index = stretch.index + self._first
        if len(index):
            state.sample_count = int(index[-1]) + 1
        fds_v, edc_v = stretch.values.T.copy()
        return EmgSamples(stretch.times_ns, fds_v, edc_v, index, stretch.gap, stretch.clock)

    def _begin_session(self) -> DeviceSession:
        assert self._line is not None
        self._line.mark_gap()
        return self._connect(self._line, self._monitor, self._host)
