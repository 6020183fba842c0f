"""What the EMG drivers have in common: a sample line, a health monitor and a thread."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

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


class EmgReceiver:
    """Receive two muscles in volts.

    Args:
        name: The device.
        connect: Begins a session that pushes to the line it is given.
        rate_hz: Nominal rate.
        stale_s: Longest silence.
        gap_s: Lateness that means loss, for a source without sequence numbers.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[SampleLine, HealthMonitor, HostTime], DeviceSession],
        rate_hz: float,
        stale_s: float,
        gap_s: float = 0.05,
    ) -> None:
        check_range(name, "rate_hz", rate_hz, 1.0, 1e5)
        check_range(name, "stale_s", stale_s, 1e-3, 60.0)
        self._name, self._rate_hz, self._gap_s = name, rate_hz, gap_s
        self._host, self._monitor = HostTime(), HealthMonitor(stale_s)
        self._line: SampleLine | None = None
        self._first = 0
        self._begin = connect
        self._receiver = SessionThread(name, self._connect, self._monitor, self._host)

    def open(self, now_ns: int, state: EmgSourceState) -> None:
        """Connect; errors as for the receiver."""
        self._receiver.refuse_if_running()
        self._host.observe(now_ns)
        self._line, self._first = SampleLine(self._rate_hz, 2, self._gap_s), state.sample_count
        self._receiver.start()

    def close(self) -> None:
        """Disconnect."""
        self._receiver.stop()

    def health(self, now_ns: int) -> DeviceHealth:
        """Return the present health."""
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())

    def drain(self, now_ns: int, state: EmgSourceState) -> EmgSamples:
        """Return every sample received since the last call.

        Raises:
            DeviceError: It was never open.
        """
        self._host.observe(now_ns)
        if self._line is None:
            raise DeviceError(f"{self._name}: not open; open it first")
        stretch = self._line.drain()
        index = stretch.index + self._first
        if len(index):
            state.sample_count = int(index[-1]) + 1
        fds_v, edc_v = stretch.values.T.copy()
        return EmgSamples(stretch.times_ns, fds_v, edc_v, index, stretch.gap, stretch.clock)

    def _connect(self) -> DeviceSession:
        assert self._line is not None
        self._line.mark_gap()
        return self._begin(self._line, self._monitor, self._host)
