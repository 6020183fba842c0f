"""EMG from a Backyard Brains SpikerShield on a serial port; counts without a calibration."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palp_core.palpation.devices.emg.emg_source import EmgDriver, EmgSourceState
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.link.serial_link import SerialLink
from palp_core.palpation.devices.unverified import warn_unverified
from palp_core.palpation.devices.wire import spikershield as wire

_BOOT_LINE = b"StartUp!\r\n"


@dataclass
class SpikerShieldEmg(EmgDriver):
    """Parameters and link. Two channels share 10 kHz; enough for EMG that is normalised to its own maximum.

    Attributes:
        url: Address as pyserial knows it.
        rate_hz: Per channel.
        volt_per_count: What a count is worth at the electrode.
        middle: Count of no signal.
        stale_s: Longest silence.
        verified: Parameters checked on the device; ``*`` for all.
    """

    UNVERIFIED: ClassVar[dict[str, str]] = {
        "volt_per_count": "the box's gain is set by hand; harmless where EMG is normalised to its maximum",
        "rate_hz": "the firmware's setting conf s:10000;c:2 means 5 kHz a channel",
    }

    LINK: ClassVar[str] = "Backyard Brains' Muscle SpikerShield: serial at 230400"

    url: str
    rate_hz: float = 5000.0
    volt_per_count: float = 4e-6
    middle: float = 512.0
    stale_s: float = 0.1
    verified: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_range("spikershield", "volt_per_count", self.volt_per_count, 1e-12, 1.0)
        check_range("spikershield", "rate_hz", self.rate_hz, 1.0, 5000.0)
        self._receive("spikershield", self.rate_hz, self.stale_s)

    def open(self, now_ns: int, state: EmgSourceState, rng: np.random.Generator) -> None:
        """Connect, set the rate and begin to receive.

        Raises:
            DeviceError: No port, or open already.
        """
        warn_unverified("spikershield", self.UNVERIFIED, self.verified)
        super().open(now_ns, state, rng)

    def _connect(self, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> _SpikerShieldSession:
        return _SpikerShieldSession(self, line, monitor, host)


class _SpikerShieldSession:
    def __init__(
        self, source: SpikerShieldEmg, line: SampleLine, monitor: HealthMonitor, host: HostTime
    ) -> None:
        self._source, self._line, self._monitor, self._host = source, line, monitor, host
        self._link = SerialLink("spikershield", source.url, wire.BAUD)
        self._decoder = wire.Decoder(2)
        self._begun = False
        try:
            self._link.write(wire.configuration(round(2 * source.rate_hz), 2))
            self._link.drop_input()
        except BaseException:
            self._link.close()
            raise

    def step(self, stop: threading.Event) -> None:
        data = self._link.read_some()
        now_ns = self._host.now_ns()
        if not data:
            return
        counts, dropped = self._decoder.feed(data.replace(_BOOT_LINE, b""))
        if dropped and self._begun:
            self._line.mark_gap()
            self._monitor.report(
                Condition.GARBLED, now_ns, f"{self._decoder.dropped_count} bytes were no frames"
            )
        if len(counts):
            self._begun = True
            self._line.append((counts - self._source.middle) * self._source.volt_per_count, now_ns)
            if not dropped:
                self._monitor.note_data(now_ns)

    def close(self) -> None:
        self._link.close()
