"""An ATI Net F/T: RDT records over UDP, and its configuration page over HTTP."""

import socket
import struct

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import Faults
from palp_core.palpation.devices.emulator.world import World
from palp_core.palpation.devices.wire.rdt import SATURATION

_COUNTS = 1_000_000
_SLICE_NS = 1_000_000


def configuration_page(path: str) -> bytes | None:
    """Return ``/netftapi2.xml`` with the scales of force and torque."""
    if path != "/netftapi2.xml":
        return None
    return (
        b'<?xml version="1.0"?><netftapi2><scfgfu>N</scfgfu><scfgtu>Nmm</scfgtu>'
        b"<cfgcpf>%d</cfgcpf><cfgcpt>%d</cfgcpt></netftapi2>" % (_COUNTS, _COUNTS)
    )


class NetFt:
    """The sensor's UDP port: one stream, to whoever asked last."""

    def __init__(
        self,
        loop: EmulatorLoop,
        world: World,
        faults: Faults,
        rate_hz: float,
        host: str = "127.0.0.1",
        clock_ppm: float = 0.0,
    ) -> None:
        self._loop, self._world, self._faults = loop, world, faults
        self._period_ns = 1e9 / (rate_hz * (1.0 + clock_ppm * 1e-6))
        self.host, self.port = host, 0
        self._socket: socket.socket | None = None
        self._client: tuple[str, int] | None = None
        self._run = self._sequence = self._left = 0
        self._begin_ns = 0
        self._bias = np.zeros(6)

    def plug(self) -> None:
        """Bind the port; the device behind it is powered up.

        Raises:
            DeviceError: The address is not of this host.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((self.host, self.port))
        except OSError as error:
            self._socket.close()
            self._socket = None
            raise DeviceError(f"emulator: no UDP on {self.host}:{self.port}: {error.strerror}") from error
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self._loop.add(self._socket, self._on_readable)

    def unplug(self) -> None:
        """Pull the cable."""
        if self._socket is not None:
            self._run += 1
            self._loop.remove(self._socket)
            self._socket.close()
            self._socket = self._client = None

    def record(self, sequence: int, sample: int, now_ns: int) -> bytes:
        """Return one record: the stream's number, the sensor's, status and counts."""
        counts = self._world.wrench(now_ns) - self._bias
        counts[3:] *= 1e3
        status = 0x80000000 | self._world.sensor_status if self._world.sensor_status else 0
        if self._world.saturated_gauges:
            status = SATURATION
        return struct.pack(
            ">III6i",
            sequence & 0xFFFFFFFF,
            sample & 0xFFFFFFFF,
            status,
            *np.rint(counts * _COUNTS).astype(int),
        )

    def _on_readable(self) -> None:
        if self._socket is None:
            return
        try:
            self.answer(*self._socket.recvfrom(64))
        except OSError:
            return

    def answer(self, datagram: bytes, sender: tuple[str, int]) -> None:
        """Obey a request; what is none is not answered."""
        if len(datagram) != 8:
            return
        header, command, count = struct.unpack(">HHI", datagram)
        if header != 0x1234:
            return
        now_ns = self._loop.now_ns()
        if command == 42:
            self._bias = self._world.true_wrench(now_ns)
        elif command in (0, 2):
            self._run += 1
            self._client = sender if command == 2 else None
            if command == 2:
                self._sequence, self._left, self._begin_ns = 0, count or -1, now_ns
                self._send(self._run)

    def _send(self, run: int) -> None:
        """Send every record that is due; asleep for a slice in between."""
        if run != self._run or self._socket is None or self._client is None:
            return
        now_ns = self._loop.now_ns()
        while self._left and self._begin_ns + (self._sequence + 1) * self._period_ns <= now_ns:
            self._sequence += 1
            self._left -= 1
            data, delay_ns = self._faults.spoil_reply(self.record(self._sequence, self._sequence, now_ns))
            if data:
                self._emit(data, delay_ns)
        if self._left:
            due_ns = self._begin_ns + round((self._sequence + 1) * self._period_ns)
            self._loop.at(
                max(due_ns, now_ns + min(_SLICE_NS, round(self._period_ns)) // 4), lambda: self._send(run)
            )

    def _emit(self, data: bytes, delay_ns: int) -> None:
        if delay_ns:
            self._loop.at(self._loop.now_ns() + delay_ns, lambda: self._emit(data, 0))
        elif self._socket is not None and self._client is not None:
            try:
                self._socket.sendto(data, self._client)
            except OSError:  # nobody listens: a datagram is lost
                return
