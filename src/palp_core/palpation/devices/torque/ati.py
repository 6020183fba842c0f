"""The torque sensor: an ATI Nano17 on a NETCANOEM, over any CAN interface that python-can knows."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import mul
from typing import Any, ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.session_thread import SessionDriver
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.torque.ati_session import (
    LOST_S,
    SET_UP_S,
    AtiSession,
    RawSample,
    SensorCalibration,
    open_bus,
)
from palp_core.palpation.devices.wire import netcanoem as wire
from palp_core.palpation.nano17 import RANGE_N_M
from palp_core.units import Float64Array

_NONE = TorqueSamples(np.empty(0, dtype=np.int64), np.empty(0), 0)
_COLUMNS = {"x": 3, "y": 4, "z": 5}


class AtiState(msgspec.Struct):
    """What outlives the driver; the caller keeps it with the data.

    Attributes:
        bias: What is subtracted, forces in N and torques in N m.
        sample_count: Samples numbered so far.
    """

    bias: list[float] = msgspec.field(default_factory=lambda: [0.0] * 6)
    sample_count: int = 0


@dataclass
class AtiTorque(SessionDriver):
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
    state_type: ClassVar[type[AtiState]] = AtiState

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
        if self.axis not in _COLUMNS or self.sign not in (1, -1):
            raise DeviceError(f"torque: axis '{self.axis}', sign {self.sign}; give x, y or z, and +1 or -1")
        self._prepare("ati", self.stale_s)
        self._samples: deque[RawSample] = deque()
        self._session: AtiSession | None = None

    def _begin(self) -> None:
        self._samples.clear()
        self._session = None

    @property
    def sensor(self) -> SensorCalibration:
        """What the sensor reported of itself when it was connected last."""
        if self._session is None:
            raise DeviceError("ati: not open; open it first")
        return self._session.calibration

    def drain(self, now_ns: int, state: AtiState, rng: np.random.Generator) -> TorqueSamples:
        """Return every sample received since the last call; a torque out of range is clipped to it.

        Of the one or two samples of a millisecond plain numbers take a tenth of what arrays take.
        """
        self._host.observe(now_ns)
        per_count, column, most = self.sensor.per_count_rows, _COLUMNS[self.axis], self.range_n_m
        raw = [self._samples.popleft() for _ in range(len(self._samples))]
        if not raw:
            return _NONE
        wrench, torque_n_m, faulty, saturated_count = [], [], [], 0
        for *_, status, values in raw:
            loads = [
                sum(map(mul, row, values)) - bias for row, bias in zip(per_count, state.bias, strict=True)
            ]
            torque, saturated = self.sign * loads[column], wire.is_saturated(values)
            saturated_count += saturated
            wrench.append(loads)
            torque_n_m.append(min(max(torque, -most), most) if saturated else torque)
            faulty.append(saturated or wire.is_bad(status))
        state.sample_count = raw[-1][1] + 1
        return TorqueSamples(
            np.array([sample[0] for sample in raw], np.int64),
            np.array(torque_n_m, np.float64),
            saturated_count,
            np.array([sample[1] for sample in raw], np.int64),
            np.array([sample[2] for sample in raw], np.bool_),
            np.array(faulty, np.bool_),
            np.array(wrench, np.float64),
        )

    def tare(self, block: TorqueSamples, state: AtiState) -> Float64Array:
        """Make the mean of ``block``, read unloaded, the new zero of forces and torques; return it."""
        if not len(block.wrench) or bool(np.any(block.faulty)):
            raise DeviceError(
                "torque: cannot tare from an empty or faulty block; unload the probe and read again"
            )
        bias: Float64Array = np.array(state.bias) + block.wrench.mean(axis=0)
        state.bias = bias.tolist()
        return bias

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
