"""The torque sensor: an ATI Nano17 on a NETCANOEM, over any CAN interface that python-can knows."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import mul
from typing import Any, ClassVar

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import DeviceHealth, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.session_thread import SessionThread
from palp_core.palpation.devices.protocols import EXACT, TorqueSamples
from palp_core.palpation.devices.torque.ati_session import (
    LOST_S,
    SET_UP_S,
    AtiSession,
    RawSample,
    SensorCalibration,
    open_bus,
)
from palp_core.palpation.devices.torque.wrench_state import WrenchState, bias_from, check_axis, torque_block
from palp_core.palpation.devices.unverified import warn_unverified
from palp_core.palpation.devices.wire import netcanoem as wire
from palp_core.palpation.nano17 import RANGE_N_M
from palp_core.units import Float64Array

_NONE = TorqueSamples(np.empty(0, dtype=np.int64), np.empty(0), 0)


@dataclass
class AtiTorque:
    """Parameters and link of the sensor.

    The calibration is read from the sensor, never shipped. A request and its replies take 253 to 305 bits: at
    the 250 kbit/s it is delivered with, 1 kHz is out of reach; code it for 500 kbit/s (operation E, code 3).

    Attributes:
        channel: The bus, as python-can calls it: a name, or a number where the interface numbers them.
        interface: The kind of bus (``socketcan``, ``slcan``, ``pcan``, ``socketcand`` ...).
        bitrate: Of the bus.
        options: Further arguments of :class:`can.Bus`.
        base_id: Bits 4 to 10 of the sensor's identifiers.
        calibration: Number of the calibration to use.
        rate_hz: Of the samples; 0 for as fast as the sensor answers.
        gap_s: A longer interval between samples is a gap, as samples have no number.
        stale_s: Longest silence.
        timeout_s: Longest wait for each answer while it is connected; twice that for a socketcand server.
        lost_s: A longer silence is a lost link, and the sensor is connected again.
        axis: The sensor's axis that the probe's joint turns about.
        sign: Direction of the torque about it.
        range_n_m: Largest torque (the maker's figure for SI-12-0.12).
        verified: Parameters checked on the device; ``*`` for all.
    """

    UNVERIFIED: ClassVar[dict[str, str]] = {
        "bitrate": "the sensor is delivered with 250 kbit/s",
        "axis": "which of the sensor's axes the joint turns about, and the sign",
        "calibration": "the sensor falls back to calibration 0 at power-up",
    }

    LINK: ClassVar[str] = "ATI NETCANOEM: CAN, any interface of python-can"
    state_type: ClassVar[type[WrenchState]] = WrenchState

    channel: str | int = "can0"
    interface: str = "socketcan"
    bitrate: int = 500_000
    options: Mapping[str, Any] = field(default_factory=dict)
    base_id: int = 0x20
    calibration: int = 0
    rate_hz: float = 1000.0
    gap_s: float = 0.003
    stale_s: float = 0.025
    timeout_s: float = SET_UP_S
    lost_s: float = LOST_S
    axis: str = "x"
    sign: int = 1
    range_n_m: float = RANGE_N_M
    verified: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_range("ati", "base_id", self.base_id, 0, 0x7F)
        check_range("ati", "calibration", self.calibration, 0, 15)
        check_range("ati", "rate_hz", self.rate_hz, 0.0, 1e4)
        check_range("ati", "gap_s", self.gap_s, 1e-4, 10.0)
        check_range("ati", "stale_s", self.stale_s, 1e-3, 10.0)
        check_range("ati", "timeout_s", self.timeout_s, 1e-3, 60.0)
        check_range("ati", "lost_s", self.lost_s, LOST_S, 60.0)
        check_range("ati", "range_n_m", self.range_n_m, 1e-9, 1e3)
        check_axis(self.axis, self.sign)
        self._host = HostTime()
        self._monitor = HealthMonitor(self.stale_s)
        self._samples: deque[RawSample] = deque()
        self._receiver = SessionThread("ati", self._connect, self._monitor, self._host)
        self._session: AtiSession | None = None
        self._first = 0

    def open(self, now_ns: int, state: WrenchState, rng: np.random.Generator) -> None:
        """Connect, choose and read the calibration, and begin to poll."""
        self._receiver.refuse_if_running()
        self._host.observe(now_ns)
        warn_unverified("ati", self.UNVERIFIED, self.verified)
        self._samples.clear()
        self._session, self._first = None, state.sample_count
        self._receiver.start()

    def close(self) -> None:
        """End the thread and release the bus."""
        self._receiver.stop()

    def health(self, now_ns: int) -> DeviceHealth:
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())

    @property
    def sensor(self) -> SensorCalibration:
        """What the sensor said of itself when it was connected last."""
        if self._session is None:
            raise DeviceError("ati: not open; open it first")
        return self._session.calibration

    def drain(self, now_ns: int, state: WrenchState, rng: np.random.Generator) -> TorqueSamples:
        """Return every sample received since the last call."""
        self._host.observe(now_ns)
        per_count = self.sensor.per_count_rows
        raw = [self._samples.popleft() for _ in range(len(self._samples))]
        if not raw:
            return _NONE
        wrench = [[sum(map(mul, row, values)) for row in per_count] for *_, values in raw]
        saturated = [wire.is_saturated(values) for *_, values in raw]
        faulty = [wire.is_bad(status) for *_, status, _ in raw]
        times_ns = np.array([r[0] for r in raw], dtype=np.int64)
        index = np.array([r[1] for r in raw], dtype=np.int64)
        gap = np.array([r[2] for r in raw], dtype=np.bool_)
        return torque_block(
            self.axis,
            self.sign,
            self.range_n_m,
            state,
            times_ns,
            index,
            gap,
            wrench,
            saturated,
            faulty,
            EXACT,
        )

    def tare(self, block: TorqueSamples, state: WrenchState) -> Float64Array:
        """Make the mean of ``block``, read unloaded, the new zero of forces and torques; return it."""
        return bias_from(block, state)

    def _connect(self) -> AtiSession:
        before, first = self._session, self._first
        if before is not None:  # what the time would have given since then is lost
            last_ns, first = before.last_ns or self._host.now_ns(), before.next
            first += max(0, round((self._host.now_ns() - last_ns) * 1e-9 * self.rate_hz) - 1)
        bus_options = {
            "interface": self.interface,
            "channel": self.channel,
            "bitrate": self.bitrate,
            **self.options,
        }
        self._session = AtiSession(
            open_bus(bus_options, 2.0 * self.timeout_s),
            self.base_id,
            self.calibration,
            self.rate_hz,
            self.gap_s,
            self._samples,
            self._monitor,
            self._host,
            first,
            before is not None,
            set_up_s=self.timeout_s,
            lost_s=self.lost_s,
        )
        return self._session
