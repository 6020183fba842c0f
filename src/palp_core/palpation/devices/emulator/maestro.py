"""A Pololu Maestro with an L12-I on channel 0 and its feedback on channel 1."""

from dataclasses import dataclass, replace

import numpy as np

from palp_core.palpation.devices.sim.ring import SimRing, SimRingState
from palp_core.palpation.devices.wire.maestro import SPEED_UNIT_US_PER_S, Error, crc7

_LENGTHS = {0x84: 4, 0x87: 4, 0x89: 4, 0x90: 2, 0x93: 1, 0xA1: 1, 0xA2: 1}
_L12_M_PER_S = 6.5e-3


class EmulatedRod:
    """The actuator's rod: a simulated ring that counts from the retracted stop."""

    def __init__(self, ring: SimRing, seed: int) -> None:
        self._zero_m = ring.zero_m
        self._ring = replace(ring, zero_m=0.0, settle_s=0.0, feedback_step_m=0.0)
        self._state, self._rng = SimRingState(), np.random.default_rng(seed)
        self._ring.open(0, self._state, self._rng)
        self.stalled = False

    @property
    def stroke_m(self) -> float:
        """Stop to stop."""
        return self._ring.stroke_m

    def move(self, extension_m: float, speed_m_per_s: float, now_ns: int) -> None:
        """Send the rod to an extension; the true landing error is drawn here."""
        if not self.stalled:
            self._ring = replace(self._ring, speed_m_per_s=speed_m_per_s)
            target_m = min(max(extension_m, 0.0), self.stroke_m)
            self._ring.command(target_m, now_ns, self._state, self._rng)

    def stall(self, now_ns: int) -> None:
        """Block the rod where it is."""
        self._ring.stop(now_ns, self._state)
        self.stalled = True

    def extension_m(self, now_ns: int) -> float:
        """Return where the rod is by its own potentiometer."""
        return self._ring.read(now_ns, self._state).measured_m

    def ring_m(self, now_ns: int) -> float:
        """Return where the ring is in truth."""
        return self._ring.true_position_m(now_ns, self._state) - self._zero_m

    @property
    def lands_m(self) -> float:
        """Where the ring is in truth once the rod rests."""
        return self._state.true_m[-1] - self._zero_m


@dataclass(frozen=True)
class MaestroSettings:
    """How the controller and the actuator are set up.

    Attributes:
        crc: Whether commands end with their check byte.
        timeout_s: Longest silence of the host; 0 for any.
        least_us: Shortest pulse; shorter targets are clamped.
        most_us: Longest pulse.
        retracted_us: Pulse of the retracted rod.
        extended_us: Pulse of the extended rod.
        counts: Feedback at full extension.
    """

    crc: bool = True
    timeout_s: float = 0.0
    least_us: float = 992.0
    most_us: float = 2000.0
    retracted_us: float = 1000.0
    extended_us: float = 2000.0
    counts: int = 675


class Maestro:
    """The controller's side of its serial line."""

    def __init__(self, rod: EmulatedRod, settings: MaestroSettings, now_ns: int = 0) -> None:
        self.greeting, self.ready_ns = b"", 0
        self._rod, self._settings = rod, settings
        self._rest = b""
        self._errors = 0
        self._speed = 0
        self._received_ns = now_ns
        self._target_us = self._from_us = settings.retracted_us
        self._from_ns = now_ns

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Carry out every complete command."""
        self._check_silence(now_ns)
        self._received_ns = now_ns
        self._rest += data
        reply = b""
        while self._rest:
            taken, answer = self._one(now_ns)
            if not taken:
                break
            self._rest = self._rest[taken:]
            reply += answer
        return reply

    def _one(self, now_ns: int) -> tuple[int, bytes]:
        """Return how many bytes the first command took (0: not all there) and the reply."""
        whole = self._rest
        pololu = whole[0] == 0xAA
        if pololu and len(whole) < 3:
            return 0, b""
        body = bytes([whole[2] | 0x80]) + whole[3:] if pololu else whole
        length = _LENGTHS.get(body[0])
        if length is None:
            self._fail(Error.PROTOCOL, now_ns)
            return 1, b""
        total = length + 2 * pololu + self._settings.crc
        if len(whole) < total:
            return 0, b""
        if self._settings.crc and crc7(whole[: total - 1]) != whole[total - 1]:
            self._fail(Error.CRC, now_ns)
            return total, b""
        if any(byte & 0x80 for byte in body[1:length]):
            self._fail(Error.PROTOCOL, now_ns)
            return total, b""
        return total, self._do(body[:length], now_ns)

    def _do(self, body: bytes, now_ns: int) -> bytes:
        value = body[2] | body[3] << 7 if len(body) == 4 else 0
        match body[0]:
            case 0x84 if body[1] == 0 and value:
                self._go(value / 4.0, now_ns)
            case 0x87 if body[1] == 0:
                self._speed = value
            case 0x90:
                return self._position(body[1], now_ns).to_bytes(2, "little")
            case 0x93:
                return bytes([self._pulse_us(now_ns) != self._target_us])
            case 0xA1:
                word, self._errors = self._errors, 0
                return word.to_bytes(2, "little")
            case 0xA2:
                self._go(self._settings.retracted_us, now_ns)
        return b""

    def _position(self, channel: int, now_ns: int) -> int:
        if channel == 0:
            return round(4.0 * self._pulse_us(now_ns))
        share = self._rod.extension_m(now_ns) / self._rod.stroke_m
        return min(1023, max(0, round(share * self._settings.counts))) if channel == 1 else 0

    def _go(self, pulse_us: float, now_ns: int) -> None:
        settings = self._settings
        self._from_us, self._from_ns = self._pulse_us(now_ns), now_ns
        self._target_us = min(max(pulse_us, settings.least_us), settings.most_us)
        m_per_us = self._rod.stroke_m / (settings.extended_us - settings.retracted_us)
        speed_m_per_s = self._speed * SPEED_UNIT_US_PER_S * m_per_us if self._speed else _L12_M_PER_S
        extension_m = (self._target_us - settings.retracted_us) * m_per_us
        self._rod.move(extension_m, min(speed_m_per_s, _L12_M_PER_S), now_ns)

    def _pulse_us(self, now_ns: int) -> float:
        """Return the pulse after the speed limit."""
        way_us = self._target_us - self._from_us
        if not self._speed:
            return self._target_us
        gone_us = (now_ns - self._from_ns) * 1e-9 * self._speed * SPEED_UNIT_US_PER_S
        if gone_us >= abs(way_us):
            return self._target_us
        return self._from_us + (gone_us if way_us > 0.0 else -gone_us)

    def _check_silence(self, now_ns: int) -> None:
        if 0.0 < self._settings.timeout_s < (now_ns - self._received_ns) * 1e-9:
            self._received_ns = now_ns
            self._fail(Error.TIMEOUT, now_ns)

    def _fail(self, error: Error, now_ns: int) -> None:
        """Set an error bit; the error action is ``ignore`` (the channel holds) but for the time-out: stop."""
        self._errors |= error
        if error is Error.TIMEOUT and self._pulse_us(now_ns) != self._target_us:
            self._go(self._pulse_us(now_ns), now_ns)
