"""Question and answer with an Aerotech controller, and back in step after a garbled or late answer."""

import math
import threading
import warnings
from contextlib import suppress

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.link.reply_timeout import ReplyTimeout
from palp_core.palpation.devices.link.serial_link import LinkLost, SerialLink
from palp_core.palpation.devices.unverified import UnverifiedWarning
from palp_core.palpation.devices.wire import aerotech as wire

_LONGEST = 64
_ALPHABET = b"%!#$0123456789+-.eE \r\n"
_ABORTS_S = (0.0, 0.02, 0.04, 0.06, 0.08)  # beyond a permission's end: a command may have crossed the first
_DISABLE_S = 0.25  # at rest from any speed that is allowed


class CommandRefused(DeviceError):
    """The controller answered that it cannot or will not.

    Attributes:
        reply: ``!`` invalid, ``#`` not executable, ``$`` timed out.
    """

    def __init__(self, sent: bytes, reply: bytes) -> None:
        asked = sent.decode("ascii").strip()
        super().__init__(
            f"aerotech: '{asked}': {wire.REPLIES[reply]} ({reply.decode()});"
            " read the axis faults, acknowledge, and mind the limits"
        )
        self.reply = reply


class AerotechLink:
    """One connection to the controller, usable from several threads.

    A bare acknowledgement may come with a line feed or without, as the controller is set up. An answer that
    is late or garbled may be followed by others: before the next question the link sends ``NONE``, which
    every controller refuses as invalid, and throws away all that comes before that refusal.
    """

    def __init__(self, url: str, baud: int, timeout_s: float) -> None:
        self._link = SerialLink("aerotech", url, baud)
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._rest = self._abort = b""
        self._in_step = True
        self.garbled_count = 0
        try:
            with self._lock:
                self._resynchronise()
        except DeviceError:
            self._link.close()
            raise

    def close(self) -> None:
        self._link.close()

    def guard(self, axes: tuple[str, ...]) -> bool:
        """Have the axes aborted, then disabled, should this process die; return whether that can be."""
        abort = wire.each("ABORT", axes)
        words = [*((after_s, abort) for after_s in _ABORTS_S), (_DISABLE_S, wire.each("DISABLE", axes))]
        if guarded := self._link.guard(words):
            self._abort = abort
        else:
            warnings.warn(
                f"aerotech: {self._link.url} cannot be shared with a guard: if this process dies, the stage"
                " goes on to the end of the move that it was sent; use socket:// or a device file",
                UnverifiedWarning,
                stacklevel=3,
            )
        return guarded

    def require_guard(self) -> None:
        """Stop and close a link whose guard has ended: nothing would stop what is commanded on it."""
        if self._link.unguarded:
            with suppress(DeviceError):
                self.send_at_once(self._abort)
            self._link.close()
            raise LinkLost(f"aerotech: the guard of {self._link.url} has ended; reopen")

    def do(self, sent: bytes, at_least_s: float = 0.0) -> None:
        """Send a command and wait for its acknowledgement, no shorter than that."""
        with self._lock:
            self._exchange(sent, at_least_s, has_value=False)

    def ask(self, question: str) -> bytes:
        """Send a question and return the value of the answer; errors as for :meth:`do`."""
        with self._lock:
            return self._exchange(wire.command(question), has_value=True)

    def number(self, question: str) -> float:
        """Return the answer as a number; errors as for :meth:`do`."""
        answer = self.ask(question)
        try:
            if math.isfinite(value := float(answer)):
                return value
            raise ValueError(value)
        except ValueError as error:
            raise self._out_of_step(f"answered {answer!r} to '{question}', no number") from error

    def bits(self, question: str) -> int:
        """Return the answer as 32 bits; errors as for :meth:`do`."""
        answer = self.ask(question)
        try:
            return wire.mask(answer)
        except DeviceError as error:
            raise self._out_of_step(f"answered {answer!r} to '{question}', no 32 bits") from error

    def send_at_once(self, commands: bytes) -> None:
        """Send at once, past a question that is under way; its answer, and this one's, are not waited for."""
        self._in_step = False
        self._link.write(commands)
        self._in_step = False  # a caller that got back in step before the bytes left is out of it now

    def _exchange(self, sent: bytes, at_least_s: float = 0.0, *, has_value: bool) -> bytes:
        if not self._in_step:
            self._resynchronise()
        self._link.write(sent)
        timeout = ReplyTimeout(max(self._timeout_s, at_least_s))
        try:
            reply = self._byte(timeout)
            while reply in b"\r\n":
                reply = self._byte(timeout)
            if reply not in wire.REPLIES:
                raise self._out_of_step(f"answered {reply!r} to {sent!r}")
            if reply != wire.ACKNOWLEDGED:
                raise CommandRefused(sent, reply)
            return self._line(timeout) if has_value else b""
        except DeviceTimeout:
            self._in_step = False
            raise

    def _resynchronise(self) -> None:
        self._rest = b""
        self._in_step = True
        self._link.write(wire.command("NONE"))
        timeout, strange = ReplyTimeout(self._timeout_s), b""
        try:
            while (byte := self._byte(timeout)) != b"!":
                if byte not in _ALPHABET and len(strange) < 8:
                    strange += byte
        except DeviceTimeout as error:
            self._in_step = False
            if strange:
                raise self._out_of_step(f"answered {strange!r} to NONE") from error
            raise
        except DeviceError:
            self._in_step = False
            raise

    def _byte(self, timeout: ReplyTimeout) -> bytes:
        while not self._rest:
            long_over, over = timeout.over, timeout.expired()
            self._rest = self._link.read_some()
            if long_over or (over and not self._rest):  # what still comes then is no answer
                raise DeviceTimeout(
                    f"aerotech: no answer within {self._timeout_s:g} s on {self._link.url};"
                    " check power, baud rate and the controller's ASCII interface"
                )
        byte, self._rest = self._rest[:1], self._rest[1:]
        return byte

    def _line(self, timeout: ReplyTimeout) -> bytes:
        line = b""
        while True:
            end = self._rest.find(b"\n")
            if end >= 0:
                line, self._rest = line + self._rest[:end], self._rest[end + 1 :]
                return line.strip()
            line, self._rest = line + self._rest, b""
            if len(line) > _LONGEST:
                raise self._out_of_step(f"answered {len(line)} bytes without an end")
            self._rest = self._byte(timeout) + self._rest

    def _out_of_step(self, what: str) -> DeviceError:
        self._in_step = False
        self.garbled_count += 1
        return DeviceError(f"aerotech: {what}; check baud rate, wiring and the reply characters")
