"""Commands and questions to a Pololu Maestro."""

import threading
import time

from palp_core.errors import DeviceTimeout
from palp_core.palpation.devices.link.serial_link import SerialLink
from palp_core.palpation.devices.wire import maestro as wire

_BAUD = 115200  # ignored by the USB command port
_SILENCE_S = 0.1
_LONGEST_TALK_S = 1.0


class MaestroLink:
    """One connection for several threads. Replies have no frame: input is dropped before a question."""

    def __init__(self, url: str, crc: bool, timeout_s: float, servo: int = 0) -> None:
        self._link = SerialLink("maestro", url, _BAUD)
        self._crc, self._timeout_s, self._servo = crc, timeout_s, servo
        self._lock = threading.Lock()
        self._late = False

    def command(self, message: bytes) -> None:
        """Send what has no answer."""
        self._link.write(wire.with_crc(message) if self._crc else message)

    def ask(self, message: bytes, count: int) -> int:
        """Return the answer's number, ``count`` bytes long."""
        with self._lock:
            if self._late:
                self._resynchronise()
            self._link.drop_input()
            self.command(message)
            self._late = True
            reply = self._link.read_exactly(count, self._timeout_s)
            self._late = False
            return int.from_bytes(reply, "little")

    def mark_out_of_step(self) -> None:
        """Get back in step before the next question: an answer made no sense."""
        self._late = True

    def position(self, channel: int) -> int:
        """Return a servo's pulse in quarters of a microsecond, or an input's voltage from 0 to 1023."""
        return self.ask(wire.get_position(channel), 2)

    def errors(self) -> wire.Error:
        """Return the error word, which clears it."""
        return wire.Error(self.ask(wire.get_errors(), 2) & 0x1FF)

    def _resynchronise(self) -> None:
        """Get back in step after an answer that did not come in time.

        Answers name no question. So the line must fall silent first; then the servo's pulse is asked for,
        which is longer than any input's reading, and whatever comes before it is thrown away.
        """
        end_s = time.monotonic() + _LONGEST_TALK_S
        until_s = time.monotonic() + _SILENCE_S
        while time.monotonic() < until_s:
            if self._link.read_some():
                until_s = time.monotonic() + _SILENCE_S
                self._refuse_talker(end_s)
        self.command(wire.get_position(self._servo))
        while int.from_bytes(self._link.read_exactly(2, self._timeout_s), "little") <= wire.LARGEST_INPUT:
            self._refuse_talker(end_s)

    def _refuse_talker(self, end_s: float) -> None:
        if time.monotonic() > end_s:
            raise DeviceTimeout(
                f"maestro: {self._link.url} sends data unrequested; "
                "check that it is not another device's port"
            )

    def close(self) -> None:
        """Release the port."""
        self._link.close()
