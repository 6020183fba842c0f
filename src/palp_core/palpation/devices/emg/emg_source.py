"""What the EMG drivers have in common: a sample line of two muscles."""

from typing import ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.link.session_thread import DeviceSession, SessionDriver
from palp_core.palpation.devices.protocols import EmgSamples


class EmgSourceState(msgspec.Struct):
    """What outlives the driver: how many samples were numbered."""

    sample_count: int = 0


class EmgDriver(SessionDriver):
    """Base of the drivers: receive two muscles in volts.

    A driver calls :meth:`_receive` in its ``__post_init__`` and defines :meth:`_session`.
    """

    state_type: ClassVar[type[EmgSourceState]] = EmgSourceState

    def _receive(self, name: str, rate_hz: float, stale_s: float) -> None:
        """Prepare to receive samples at a rate."""
        check_range(name, "rate_hz", rate_hz, 1.0, 1e5)
        self._prepare(name, stale_s)
        self._line: SampleLine | None = None
        self._line_hz = rate_hz

    def _session(self, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> DeviceSession:
        """Begin a session that appends to ``line``."""
        raise NotImplementedError

    def _begin(self) -> None:
        self._line = SampleLine(self._line_hz, 2)

    def _connect(self) -> DeviceSession:
        assert self._line is not None
        self._line.mark_gap()
        return self._session(self._line, self._monitor, self._host)

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
