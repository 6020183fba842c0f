"""The torque sensor: an ATI Net F/T, which streams records over UDP."""

from __future__ import annotations

import http.client
import socket
import threading
import xml.etree.ElementTree as ElementTree
from contextlib import closing
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palp_core.errors import DeviceError
from palp_core.foreign import catch_foreign
from palp_core.palpation.devices.health import Condition, DeviceHealth, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.link.session_thread import SessionThread
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.torque.wrench_state import WrenchState, bias_from, check_axis, torque_block
from palp_core.palpation.devices.wire import rdt
from palp_core.palpation.nano17 import RANGE_N_M
from palp_core.units import Float64Array

FIRST_S = 1.0  # assumed: the box answers at once, but a busy host may not listen at once
LOST_S = 0.2
_WAIT_S = 0.05
_FORCE_N = {
    "lbf": 4.4482216152605,
    "N": 1.0,
    "klbf": 4448.2216152605,
    "kN": 1e3,
    "kgf": 9.80665,
    "kg": 9.80665,
}
_TORQUE_N_M = {
    "lbf-in": 4.4482216152605 * 0.0254,
    "lbf-ft": 4.4482216152605 * 0.3048,
    "Nm": 1.0,
    "Nmm": 1e-3,
    "kgcm": 9.80665e-2,
    "kNm": 1e3,
}
_SEQUENCES = 1 << 32
_MOST_MISSING = 7000  # a second at most; a record from further on is believed once another follows it


@dataclass
class NetFtTorque:
    """Parameters and link of the sensor.

    Attributes:
        host: Its address.
        port: UDP port of the records.
        http_port: TCP port of the page with the scales.
        rate_hz: Rate of the records as set up on its page.
        stale_s: Longest silence.
        timeout_s: Longest wait for an answer.
        lost_s: After this silence the stream is started again.
        axis: The sensor's axis that the probe's joint turns about.
        sign: Direction of the torque about it.
        range_n_m: Largest torque (the maker's figure for SI-12-0.12).
    """

    LINK: ClassVar[str] = "ATI Net F/T: UDP 49152"
    state_type: ClassVar[type[WrenchState]] = WrenchState

    host: str
    port: int = rdt.PORT
    http_port: int = 80
    rate_hz: float = 1000.0
    stale_s: float = 0.025
    timeout_s: float = FIRST_S
    lost_s: float = LOST_S
    axis: str = "x"
    sign: int = 1
    range_n_m: float = RANGE_N_M

    def __post_init__(self) -> None:
        check_range("netft", "rate_hz", self.rate_hz, 1.0, 7000.0)
        check_range("netft", "stale_s", self.stale_s, 1e-3, 10.0)
        check_range("netft", "timeout_s", self.timeout_s, 1e-3, 60.0)
        check_range("netft", "lost_s", self.lost_s, _WAIT_S, 60.0)
        check_range("netft", "range_n_m", self.range_n_m, 1e-9, 1e3)
        check_axis(self.axis, self.sign)
        self._host = HostTime()
        self._monitor = HealthMonitor(self.stale_s)
        self._receiver = SessionThread("netft", self._connect, self._monitor, self._host)
        self._line = SampleLine(self.rate_hz, 7)
        self._scale = np.ones(6)
        self._first = 0

    def open(self, now_ns: int, state: WrenchState, rng: np.random.Generator) -> None:
        """Read the scales and start the stream.

        Raises:
            DeviceError: The sensor does not answer, or is open already.
        """
        self._receiver.refuse_if_running()
        self._host.observe(now_ns)
        self._first = state.sample_count
        self._line = SampleLine(self.rate_hz, 7)
        self._receiver.start()

    def close(self) -> None:
        """Stop the stream."""
        self._receiver.stop()

    def health(self, now_ns: int) -> DeviceHealth:
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())

    def drain(self, now_ns: int, state: WrenchState, rng: np.random.Generator) -> TorqueSamples:
        """Return every sample received since the last call."""
        self._host.observe(now_ns)
        stretch = self._line.drain()
        status = stretch.values[:, 0].astype(np.int64)
        saturated = (status & rdt.SATURATION) != 0
        return torque_block(
            self.axis,
            self.sign,
            self.range_n_m,
            state,
            stretch.times_ns,
            stretch.index + self._first,
            stretch.gap,
            (stretch.values[:, 1:] * self._scale).tolist(),
            saturated.tolist(),
            (status != 0).tolist(),
            stretch.clock,
        )

    def tare(self, block: TorqueSamples, state: WrenchState) -> Float64Array:
        """Make the mean of ``block``, read unloaded, the new zero of forces and torques; return it."""
        return bias_from(block, state)

    def _connect(self) -> _NetFtStream:
        self._scale = _read_scale(self.host, self.http_port, self.timeout_s)
        return _NetFtStream(self, RecordReader(self._line, self._monitor, self._host))


class _NetFtStream:
    """One run of the stream. UDP has no connection: silence is answered by starting the stream again."""

    def __init__(self, sensor: NetFtTorque, reader: RecordReader) -> None:
        self._reader, self._lost_s = reader, sensor.lost_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            self._socket.connect((sensor.host, sensor.port))
            self._socket.settimeout(sensor.timeout_s)
            self._socket.send(rdt.request(rdt.START))
            first = self._socket.recv(65536)
            self._socket.settimeout(_WAIT_S)
        except BaseException:
            self._socket.close()
            raise
        self._silent_s = 0.0
        reader.take(first)

    def step(self, stop: threading.Event) -> None:
        try:
            datagram = self._socket.recv(65536)
        except TimeoutError:
            self._silent_s += _WAIT_S  # of this thread: a busy host is no silence
            if self._silent_s > self._lost_s - _WAIT_S / 2:
                raise DeviceError(
                    f"netft: silent for {self._silent_s:g} s; check power and network"
                ) from None
            return
        self._silent_s = 0.0
        self._reader.take(datagram)

    def close(self) -> None:
        try:
            self._socket.send(rdt.request(rdt.STOP))
        finally:
            self._socket.close()


class RecordReader:
    """Number the records of one run of the stream, and judge their status.

    Args:
        line: Where samples go.
        monitor: Gets what is noted about the data.
        time: When it comes.
    """

    def __init__(self, line: SampleLine, monitor: HealthMonitor, time: HostTime) -> None:
        self._line, self._monitor, self._time = line, monitor, time
        self._base = self._number = 0  # our number of the sensor's record 0; the record that is due next
        self._doubted = -1  # the record that would follow one that made no sense

    def take(self, datagram: bytes) -> None:
        """Take the records of a datagram; those that make no sense are reported."""
        now_ns = self._time.now_ns()
        try:
            records = rdt.records(datagram)
        except DeviceError as error:
            self._monitor.report(Condition.GARBLED, now_ns, str(error))
            return
        if not len(records):
            return
        sequence = int(records["rdt"][0])
        missing = (sequence - self._number) % _SEQUENCES
        if missing > _MOST_MISSING:
            if sequence != self._doubted:
                self._doubted = (sequence + len(records)) % _SEQUENCES
                said = f"record {sequence}, where {self._number} is due"
                self._monitor.report(Condition.GARBLED, now_ns, said)
                return
            self._number, missing = 0, sequence
        self._doubted = -1
        if not self._number:
            self._base = self._line.restart_numbering(len(records), now_ns) - sequence
        first, self._number = self._number + missing, self._number + missing + len(records)
        values = np.column_stack([records["status"], records["counts"]]).astype(np.float64)
        self._line.append(values, now_ns, self._base + first)
        self._judge(int(np.bitwise_or.reduce(records["status"])), now_ns)

    def _judge(self, status: int, now_ns: int) -> None:
        self._monitor.note_contact(now_ns)
        if status & rdt.SATURATION:
            self._monitor.report(Condition.SATURATED, now_ns, "a gauge is at the end of its range")
        elif status:
            self._monitor.report(Condition.DEVICE_FAULT, now_ns, f"status {status:#010x}")
        else:
            self._monitor.note_data(now_ns)


def _read_scale(host: str, port: int, timeout_s: float) -> np.ndarray:
    """Return what a count is worth, forces in N and torques in N m, shape (6,), from the sensor's page.

    Raises:
        DeviceError: No page, or no scales on it.
    """
    place = f"netft: cannot read the scales from http://{host}:{port}/netftapi2.xml"
    connection = http.client.HTTPConnection(host, port, timeout=timeout_s)
    with catch_foreign(place, DeviceError, "check the address"), closing(connection):
        connection.request("GET", "/netftapi2.xml")
        tree = ElementTree.fromstring(connection.getresponse().read())
        per_force, per_torque = float(tree.findtext("cfgcpf", "")), float(tree.findtext("cfgcpt", ""))
        force_n = _FORCE_N[tree.findtext("scfgfu", "N").strip()]
        torque_n_m = _TORQUE_N_M[tree.findtext("scfgtu", "Nmm").strip().replace("-m", "m")]
        return np.array([force_n / per_force] * 3 + [torque_n_m / per_torque] * 3)
