"""One connection to an ATI NETCANOEM: set-up questions, then one exchange per sample."""

import logging
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import can
import numpy as np

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.foreign import catch_foreign
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.reply_timeout import ReplyTimeout
from palp_core.palpation.devices.torque.socketcand import GREETING_S, open_socketcand
from palp_core.palpation.devices.wire import netcanoem as wire
from palp_core.units import Float64Array

RawSample = tuple[int, int, bool, int, tuple[int, ...]]
"""Host time, number, gap, status word and gauges."""

SET_UP_S = 0.5
LOST_S = 0.25  # after the second reply in a row; longer than any bus holds a frame back
_QUIET_S = 0.008  # after a reply that did not come in time
_LOOK_S = 0.002
_MOST_LATE = 1_000  # frames that wait after an outage


class SensorCalibration:
    """What the sensor reports of itself.

    Attributes:
        per_count: Forces in N and torques in N m per count of each gauge, shape (6, 6).
        per_count_rows: The same as plain numbers.
        serial_number: Of the sensor.
        firmware: Major, minor, build.
    """

    def __init__(self, per_count: Float64Array, serial_number: str, firmware: tuple[int, int, int]) -> None:
        self.per_count, self.serial_number, self.firmware = per_count, serial_number, firmware
        self.per_count_rows: list[list[float]] = per_count.tolist()


class AtiSession:
    """Poll the sensor at a rate, or as fast as it answers.

    The sensor streams nothing and numbers nothing: a sample is one request and two replies, stamped in the
    middle between the two times, and a late reply looks like a prompt one. So only one request is under way:
    a reply that is late is waited for and thrown away before the next request. Once the bus has been quiet
    for 8 ms the reply is taken for lost; after a second one for 0.25 s, and then the link is. Hence a steady
    delay never yields a sample that passes for fresh, unless it is shorter than those 8 ms and two waits for
    a prompt reply, 12 ms in all at 1 kHz.
    """

    def __init__(
        self,
        bus: Any,
        base_id: int,
        calibration: int,
        rate_hz: float,
        gap_s: float,
        samples: deque[RawSample],
        monitor: HealthMonitor,
        host: HostTime,
        first: int,
        gap: bool,
        *,
        set_up_s: float = SET_UP_S,
        lost_s: float = LOST_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._id = base_id << 4
        self._samples, self._monitor, self._host, self._now_ns = samples, monitor, host, host.now_ns
        self._period_ns = round(1e9 / rate_hz) if rate_hz else 0
        self._gap_ns, self._rate_hz = round(gap_s * 1e9), rate_hz
        self._prompt_s = max(1.0 / rate_hz, 0.002) if rate_hz else 0.005
        self.next, self._gap = first, gap
        self._due_ns = self.last_ns = 0
        self._owed = self._missed = 0
        self._request = can.Message(arbitration_id=self._id, is_extended_id=False, data=b"")
        self._set_up_s, self._lost_s, self._clock = set_up_s, lost_s, clock
        self._bus = bus
        try:
            self.calibration = self._set_up(calibration)
        except BaseException:
            self._bus.shutdown()
            raise

    def close(self) -> None:
        self._bus.shutdown()

    def step(self, stop: threading.Event) -> None:
        """Wait for the next sample's time and take it."""
        if self._period_ns:
            wait_ns = self._due_ns - self._host.now_ns()
            if wait_ns > 0:
                if stop.wait(wait_ns * 1e-9):
                    return
            elif wait_ns < -self._period_ns:
                self._due_ns = self._host.now_ns()
            self._due_ns += self._period_ns
            self._drop_late()
        asked_ns = self._now_ns()
        pair = self._exchange()
        if pair is None:
            self._missed += 1
            self._settle(stop)
            return
        if self._missed and not self._period_ns:  # nothing else would notice that one was late, not lost
            self._pair(_QUIET_S)
        self._owed = self._missed = 0
        now_ns = self._now_ns()
        status, values = wire.gauges(*pair)
        self._keep((asked_ns + now_ns) // 2, status, values)
        self._judge(status, values, now_ns)

    def _exchange(self) -> tuple[bytes, bytes] | None:
        """Ask, and return the data of both replies if they come in time."""
        self._send(self._request)
        self._owed += 1
        return self._pair(self._prompt_s)

    def _settle(self, stop: threading.Event) -> None:
        """Throw away what was asked for and comes late, until nothing is owed or the bus is quiet."""
        received = False
        while self._owed and not stop.is_set():
            if self._pair(_QUIET_S if self._missed == 1 else self._lost_s, stop) is not None:
                self._owed, received = self._owed - 1, True
            elif self._missed == 1:
                return
            elif received:
                self._owed = 0
            elif not stop.is_set():
                raise DeviceTimeout(
                    f"ati: no answer within {self._lost_s:g} s; check power, bit rate and identifier"
                )

    def _pair(self, timeout_s: float, stop: threading.Event | None = None) -> tuple[bytes, bytes] | None:
        """Return the data of the next two replies that belong together, if they come in time."""
        timeout = ReplyTimeout(timeout_s, 2.0 * _LOOK_S, self._clock)
        first: bytes | None = None
        receive, identifier, over = self._receive, self._id, False
        while not over and not (stop and stop.is_set()):
            over = timeout.expired()
            message = receive(0.0 if over else _LOOK_S)
            if message is None:
                continue
            data = message.data
            if message.arbitration_id == identifier and len(data) == 8:  # our own request has 0
                first = bytes(data)
            elif message.arbitration_id == identifier + 1 and len(data) == 6 and first is not None:
                return first, bytes(data)
        return None

    def _send(self, message: can.Message) -> None:
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise DeviceError(f"ati: the bus is lost: {error}") from error

    def _receive(self, timeout_s: float) -> can.Message | None:
        try:
            message: can.Message | None = self._bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise DeviceError(f"ati: the bus is lost: {error}") from error
        return message

    def _keep(self, stamp_ns: int, status: int, values: tuple[int, ...]) -> None:
        late, gap = stamp_ns - self.last_ns > self._gap_ns, self._gap
        if late and self.last_ns:
            gap = True
            self.next += max(0, round((stamp_ns - self.last_ns) * 1e-9 * self._rate_hz) - 1)
        self._samples.append((stamp_ns, self.next, gap, status, values))
        self.next += 1
        self.last_ns, self._gap = stamp_ns, False

    def _judge(self, status: int, values: tuple[int, ...], now_ns: int) -> None:
        if wire.is_bad(status):
            self._monitor.note_contact(now_ns)
            words = wire.SensorStatus(status).words
            self._monitor.report(Condition.DEVICE_FAULT, now_ns, f"status: {words}")
            return
        if wire.is_saturated(values):
            self._monitor.note_contact(now_ns)
            self._monitor.report(Condition.SATURATED, now_ns, "a gauge is at the end of its range")
            return
        self._monitor.note_data(now_ns)

    def _drop_late(self) -> None:
        for _ in range(_MOST_LATE):  # a bus that never falls silent has another talker
            if self._receive(0.0) is None:
                return

    def _ask(self, operation: wire.Operation, data: bytes, lengths: list[int]) -> bytes:
        """Return the data of the replies to a set-up question, whose identifiers go up by one."""
        identifier = self._id | operation
        replies: list[bytes] = []
        self._send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
        look_s = self._set_up_s / 10
        timeout, over = ReplyTimeout(self._set_up_s, 2.0 * look_s, self._clock), False
        while len(replies) < len(lengths) and not over:
            over = timeout.expired()
            message = self._receive(look_s)
            wanted = (identifier + len(replies), lengths[len(replies)])
            if message is not None and (message.arbitration_id, len(message.data)) == wanted:
                replies.append(bytes(message.data))
        if len(replies) < len(lengths):
            raise DeviceTimeout(
                f"ati: no answer to {operation.name} on identifier {identifier:#x} within"
                f" {self._set_up_s:g} s; check power, identifier, and that the bus has the sensor's bit rate"
                " (new: 250 kbit/s)"
            )
        return b"".join(replies)

    def _set_up(self, number: int) -> SensorCalibration:
        operation = wire.Operation
        self._ask(operation.SET_CALIBRATION, bytes([number]), [1])
        major, minor, build = struct.unpack(">BBH", self._ask(operation.FIRMWARE, b"", [4]))
        serial_number = self._ask(operation.SERIAL_NUMBER, b"", [8]).decode("ascii", "replace").strip()
        units = self._ask(operation.UNITS, b"", [2])
        if units[0] not in wire.FORCE_UNIT_N or units[1] not in wire.TORQUE_UNIT_N_M:
            raise DeviceError(f"ati: units {units[0]} and {units[1]} are not known; check the calibration")
        counts = (1_000_000, 1_000_000)
        if (major, minor) >= (3, 7):
            counts = struct.unpack(">II", self._ask(operation.COUNTS_PER_UNIT, b"", [8]))
        rows = [
            struct.unpack(">6f", self._ask(operation.MATRIX_ROW, bytes([i]), [8, 8, 8])) for i in range(6)
        ]
        scale = [wire.FORCE_UNIT_N[units[0]] / counts[0]] * 3 + [
            wire.TORQUE_UNIT_N_M[units[1]] / counts[1]
        ] * 3
        per_count = np.array(rows) * np.array(scale)[:, None]
        if not np.all(np.isfinite(per_count)) or np.linalg.matrix_rank(per_count) < 6:
            raise DeviceError(
                f"ati: calibration {number} is not a regular matrix; choose another calibration"
            )
        return SensorCalibration(per_count, serial_number, (major, minor, build))


def open_bus(options: Mapping[str, Any], greeting_s: float = GREETING_S) -> Any:
    """Open the bus."""
    # python-can warns at every frame that came in two pieces
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)
    interface = options.get("interface")
    place = f"ati: cannot open the bus {interface} {options.get('channel')}"
    fix = f"check interface, channel and options, and that the driver of '{interface}' is installed"
    with catch_foreign(place, DeviceError, fix):
        if interface == "socketcand":
            return open_socketcand(options, greeting_s)
        return can.Bus(**options)
