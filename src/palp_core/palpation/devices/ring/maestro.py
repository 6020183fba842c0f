"""The ring's actuator: an L12-I that a Pololu Maestro commands by pulses and whose feedback it reads.

What the Maestro calls the position of a servo channel is the pulse it sends; where the rod is shows only the
feedback lead on an input channel, which the driver uses.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import DeviceHealth, HealthMonitor
from palp_core.palpation.devices.limits import DutyCycle, check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.protocols import RingReading
from palp_core.palpation.devices.ring.maestro_link import MaestroLink
from palp_core.palpation.devices.ring.maestro_motion import RodMotion
from palp_core.palpation.devices.unverified import warn_unverified
from palp_core.palpation.devices.wire import maestro as wire

_TOP_SPEED_M_PER_S = 6.5e-3  # L12-50-210-06 without load
_SHORTEST_WAIT_S = 1.0


class MaestroState(msgspec.Struct):
    """What outlives the driver.

    Attributes:
        homed: Whether the ring was brought to 0.
        target_m: What was last commanded.
        settled_ns: When it was predicted to have settled.
        runs: When the motor ran within the window of its duty cycle.
    """

    homed: bool = False
    target_m: float = 0.0
    settled_ns: int = 0
    runs: list[tuple[int, int]] = []


@dataclass
class MaestroRing:
    """Parameters and link of the ring.

    Attributes:
        url: Address as pyserial knows it; the Maestro's command port in the mode USB Dual Port.
        crc: Whether the Maestro is set to expect check bytes.
        servo: Channel of the pulses.
        feedback: Input channel of the actuator's feedback lead.
        retracted_us: Pulse of the retracted rod.
        extended_us: Pulse of the extended rod.
        retracted_counts: Feedback of the retracted rod.
        extended_counts: Feedback of the extended rod.
        stroke_m: Way between the two (data sheet: 50 mm).
        zero_m: Extension at ring position 0, inside the stroke.
        margin_m: Way kept from both ends, where the motor could stall.
        speed_m_per_s: Speed of travel, set in steps of 1.25 mm/s at the nominal pulses.
        settle_s: From arrival to rest, in the times that are predicted (assumed).
        arrived_m: How close the feedback must come (data sheet: repeatability +-0.3 mm).
        arrived_count: For how many polls.
        stall_s: Longest time without progress while moving.
        duty: Largest share of the time that the motor runs (data sheet: 20 %).
        duty_window_s: Over which that holds (assumed).
        poll_hz: Rate of the feedback.
        stale_s: Longest silence; four polls at least.
        timeout_s: Longest wait for an answer.
        verified: Parameters checked on the device; ``*`` for all.
    """

    LINK: ClassVar[str] = "Pololu Maestro with CRC, driving an L12-I: serial"
    ADDRESS: ClassVar[str] = "url:=/dev/ttyACM0"
    UNVERIFIED: ClassVar[dict[str, str]] = {
        "pulses": "retracted_us and extended_us: another family of actuators is reversed; try both ends",
        "counts": "retracted_counts and extended_counts: read the feedback at both ends",
        "zero_m": "where the ring's zero lies in the stroke",
        "duty_window_s": "the data sheet gives 20 % but no window",
    }

    state_type: ClassVar[type[MaestroState]] = MaestroState

    url: str
    crc: bool = True
    servo: int = 0
    feedback: int = 1
    retracted_us: float = 1000.0
    extended_us: float = 2000.0
    retracted_counts: float = 0.0
    extended_counts: float = 675.0
    stroke_m: float = 0.050
    zero_m: float = 1.0e-3
    margin_m: float = 0.5e-3
    speed_m_per_s: float = 5.0e-3
    settle_s: float = 0.2
    arrived_m: float = 0.3e-3
    arrived_count: int = 3
    stall_s: float = 1.0
    duty: float = 0.2
    duty_window_s: float = 300.0
    poll_hz: float = 50.0
    stale_s: float = 0.25
    timeout_s: float = 0.1
    verified: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_range("ring", "stroke_m", self.stroke_m, 1e-6, 1.0)
        check_range("ring", "margin_m", self.margin_m, 0.0, self.stroke_m / 4)
        check_range("ring", "zero_m", self.zero_m, self.margin_m, self.stroke_m - self.margin_m)
        check_range("ring", "speed_m_per_s", self.speed_m_per_s, 1e-4, _TOP_SPEED_M_PER_S)
        check_range("ring", "poll_hz", self.poll_hz, 5.0, 500.0)
        check_range("ring", "retracted_us", self.retracted_us, 64.0, 4000.0)
        check_range("ring", "extended_us", self.extended_us, 64.0, 4000.0)
        for name, low in (("settle_s", 0.0), ("stall_s", 0.05), ("stale_s", 1e-3), ("timeout_s", 1e-3)):
            check_range("ring", name, getattr(self, name), low, 60.0)
        if self.retracted_us == self.extended_us or self.retracted_counts == self.extended_counts:
            raise DeviceError(
                "ring: retracted and extended end have the same pulse or counts; calibrate them"
            )
        self._host = HostTime()
        self._monitor = HealthMonitor(max(self.stale_s, 4.0 / self.poll_hz))
        self._duty = DutyCycle(self.duty, self.duty_window_s)
        self._motion: RodMotion | None = None

    @property
    def _limits_m(self) -> tuple[float, float]:
        """Smallest and largest target."""
        return 0.0, self.stroke_m - self.zero_m - self.margin_m

    def open(self, now_ns: int, state: MaestroState, rng: np.random.Generator) -> None:
        """Connect, set speed before the first target, and bring a fresh ring to 0."""
        self._host.observe(now_ns)
        if self._motion is not None:
            raise DeviceError("ring: open already; close it first")
        warn_unverified("ring", self.UNVERIFIED, self.verified)
        link = MaestroLink(self.url, self.crc, self.timeout_s, self.servo)
        motion = RodMotion(link, self, self._host, self._monitor)
        try:
            link.errors()  # what happened before this connection
            link.command(wire.set_speed(self.servo, self._speed_steps))
            motion.start()
        except BaseException:
            link.close()
            raise
        self._motion = motion
        self._duty.restore(state.runs)
        if not state.homed:
            self._go([0.0], state)
            if not motion.wait((state.settled_ns - self._host.now_ns()) * 1e-9 + 2.0 * self.stall_s):
                self.close()
                raise DeviceError(
                    "ring: did not arrive at 0; check the actuator's supply, and calibrate pulses and counts"
                )
            state.homed = True
        elif state.settled_ns <= self._host.now_ns():
            motion.resume(state.target_m)

    def close(self) -> None:
        """Release the link; the actuator holds its place."""
        if self._motion is not None:
            self._motion.stop_polling()
            self._motion = None

    def health(self, now_ns: int) -> DeviceHealth:
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())

    def command(self, target_m: float, now_ns: int, state: MaestroState, rng: np.random.Generator) -> int:
        """Go to ``target_m``; return the predicted time of rest in ns.

        The move waits if the motor has run for its share of the window; the time returned contains that.

        Raises:
            DeviceError: A target beyond the limits, or a ring that is not up or not in health.
        """
        self._host.observe(now_ns)
        motion = self._ready(state)
        check_range("ring", "target_m", target_m, *self._limits_m)
        if target_m == state.target_m and not motion.holding:
            return state.settled_ns
        return self._go([target_m], state)

    def rehome(self, now_ns: int, state: MaestroState, rng: np.random.Generator) -> int:
        """Drive to the retracted margin and back to the target; return the predicted time of rest in ns."""
        self._host.observe(now_ns)
        self._ready(state)
        return self._go([self.margin_m - self.zero_m, state.target_m], state)

    def stop(self, now_ns: int, state: MaestroState) -> None:
        """Hold where the rod is, at once."""
        self._host.observe(now_ns)
        if self._motion is not None:
            self._motion.hold()
            self._duty.end_run(self._host.now_ns())
            state.runs = self._duty.runs

    def acknowledge(self, now_ns: int, state: MaestroState) -> None:
        """Leave a stall or a reported error behind: the operator's step, when the cause is gone."""
        self._host.observe(now_ns)
        if self._motion is None:
            raise DeviceError("ring: not open; open it first")
        self._motion.acknowledge()

    def read(self, now_ns: int, state: MaestroState) -> RingReading:
        """Return target, measured position, whether it rests at the target, and for what it waits."""
        self._host.observe(now_ns)
        if self._motion is None:
            raise DeviceError("ring: not open; open it first")
        settled = state.homed and self._motion.arrived and self._host.now_ns() >= state.settled_ns
        waits_s = self._motion.waits_ns(self._host.now_ns()) / 1e9
        waits = ""
        if waits_s >= _SHORTEST_WAIT_S:
            waits = (
                f"its motor may run {100 * self.duty:g} % of the time alone, and waits {waits_s:.0f} s more"
            )
        return RingReading(state.target_m, self._motion.measured_m, settled, waits)

    def discover(self) -> dict[str, str]:
        """Return feedback and pulse; nothing moves."""
        link = MaestroLink(self.url, self.crc, self.timeout_s, self.servo)
        try:
            link.mark_out_of_step()  # the line must be silent without a question
            counts, pulse_us = link.position(self.feedback), link.position(self.servo) / 4.0
            if counts > wire.LARGEST_INPUT or pulse_us > wire.LONGEST_US:
                raise DeviceError(
                    f"maestro: feedback {counts} counts, pulse {pulse_us:g} us are out of range;"
                    " check the port, the baud rate and the setting crc"
                )
            return {
                "feedback": f"{counts} counts, {self.ring_m(counts) * 1e3:.2f} mm by the present calibration",
                "pulse": f"{pulse_us:.2f} us",
            }
        finally:
            link.close()

    def quarter_us(self, ring_m: float) -> int:
        """Return the pulse of a ring position in quarters of a microsecond."""
        share = (ring_m + self.zero_m) / self.stroke_m
        return round(4.0 * (self.retracted_us + share * (self.extended_us - self.retracted_us)))

    def ring_m(self, counts: int) -> float:
        """Return the ring position of a feedback reading."""
        share = (counts - self.retracted_counts) / (self.extended_counts - self.retracted_counts)
        return share * self.stroke_m - self.zero_m

    @property
    def _speed_steps(self) -> int:
        us_per_s = self.speed_m_per_s * abs(self.extended_us - self.retracted_us) / self.stroke_m
        return max(1, math.floor(us_per_s / wire.SPEED_UNIT_US_PER_S))

    @property
    def _true_speed_m_per_s(self) -> float:
        """The speed after rounding to the Maestro's steps."""
        m_per_us = self.stroke_m / abs(self.extended_us - self.retracted_us)
        return self._speed_steps * wire.SPEED_UNIT_US_PER_S * m_per_us

    def _ready(self, state: MaestroState) -> RodMotion:
        if self._motion is None or not state.homed:
            raise DeviceError("ring: not up; open it first")
        health = self._monitor.read(self._host.now_ns())
        if not health.ok:
            raise DeviceError(
                f"ring: {health.condition}: {health.cause}; clear the cause and acknowledge before a move"
            )
        return self._motion

    def _go(self, targets_m: list[float], state: MaestroState) -> int:
        assert self._motion is not None
        places = [self._motion.measured_m, *targets_m]
        ways_m = [abs(b - a) for a, b in pairwise(places)]
        run_ns = round(sum(ways_m) / self._true_speed_m_per_s * 1e9)
        self._duty.end_run(self._host.now_ns())
        start_ns = self._duty.start_ns(self._host.now_ns(), run_ns)
        self._duty.add_run(start_ns, start_ns + run_ns)
        state.runs = self._duty.runs
        self._motion.follow(targets_m, start_ns)
        state.target_m = targets_m[-1]
        state.settled_ns = (
            start_ns + run_ns + round((self.settle_s + self.arrived_count / self.poll_hz) * 1e9)
        )
        return state.settled_ns
