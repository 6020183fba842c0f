"""The stage on an Aerotech controller: y along the sweep, z above the scanning height, x across if it has it.

A move is bounded, never a jog, so that a host that dies leaves the stage at the end of a short leg. A path
of several legs is sent leg by leg by the driver's thread, which also polls positions, status and faults. A
leg sideways begins only when the measured height is that of the way back, and is aborted when it no longer
is. The driver never acknowledges a fault by itself.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, get_args

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import DeviceHealth, HealthMonitor
from palp_core.palpation.devices.limits import TravelLimits, check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.protocols import (
    Direction,
    Int64Array,
    StageFeedback,
    StageReading,
    SweepTimes,
)
from palp_core.palpation.devices.stage import aerotech_motion
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop
from palp_core.palpation.devices.unverified import warn_unverified
from palp_core.palpation.devices.wire import aerotech as wire

_PLACE_M = 50e-6  # how close to a place counts as being there
_NO_WAY_M = _PLACE_M / 10  # a shorter leg is none
_SINKS_M = (
    1e-4  # how far below the way back a leg sideways may be (assumed; the gel is 0.5 mm further at least)
)


class AerotechState(msgspec.Struct):
    """What outlives the driver: whether the stage was brought up."""

    homed: bool = False


@dataclass
class AerotechStage:
    """Parameters and link of the stage. The controller counts in millimetres.

    Attributes:
        url: Address as pyserial knows it: ``/dev/ttyUSB0`` or ``socket://HOST:8000``.
        baud: Of a serial line.
        axes: The controller's names of the axes y and z, and of x if the stage moves across.
        origin_m: Controller's position of y = 0, z = 0 and x = 0.
        sign: Direction of y, z and x on the controller's axes, each +1 or -1.
        limits: Window and speed, checked before a move is sent.
        sweep_speed_m_per_s: Speed of a sweep (the paper: 20 mm/s).
        return_speed_m_per_s: Speed of the way back.
        lift_speed_m_per_s: Speed of raising and lowering.
        lift_m: Height of the way back.
        lead_m: Way at full speed before a sweep's interval.
        segment_m: Longest move that is sent at once, 2 mm on a single RS-232; 0 with a second link.
        settle_s: Allowance for starting and ending a leg, in the times that are predicted.
        poll_hz: How often positions are read; four questions each, so 50 Hz fill 42 % of a line at 115200;
            with three axes five questions, 52 %.
        stale_s: Longest silence.
        timeout_s: Longest wait for an answer.
        home_timeout_s: Longest homing.
        home_on_open: Whether opening homes axes that are not; it drives them to their references.
        verified: Parameters checked on the device; ``*`` for all.
    """

    LINK: ClassVar[str] = "Aerotech ASCII (Ensemble, Soloist): serial or TCP 8000"
    ADDRESS: ClassVar[str] = "url:=/dev/ttyUSB0 or url:=socket://HOST:8000"
    UNVERIFIED: ClassVar[dict[str, str]] = {
        "baud": "the controller's parameter 111",
        "axes": "which axis sweeps, which lifts, and which moves across if one does",
        "origin_m": "where the bead and the scanning height are",
        "sign": "which way the axes count",
        "limits": "the stage's variant and travel; the speed stays at 50 mm/s until it is known",
    }

    state_type: ClassVar[type[AerotechState]] = AerotechState

    url: str
    baud: int = 115200
    axes: tuple[str, ...] = ("X", "Y")
    origin_m: tuple[float, ...] = (0.0, 0.0)
    sign: tuple[int, ...] = (1, 1)
    limits: TravelLimits = field(default_factory=TravelLimits)
    sweep_speed_m_per_s: float = 0.020
    return_speed_m_per_s: float = 0.050
    lift_speed_m_per_s: float = 0.020
    lift_m: float = 0.020
    lead_m: float = 1e-3
    segment_m: float = 0.0
    settle_s: float = 0.08
    poll_hz: float = 50.0
    stale_s: float = 0.25
    timeout_s: float = 0.25
    home_timeout_s: float = 60.0
    home_on_open: bool = True
    verified: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("sweep_speed_m_per_s", "return_speed_m_per_s", "lift_speed_m_per_s"):
            check_range("stage", name, getattr(self, name), 1e-6, self.limits.speed_m_per_s)
        check_range("stage", "lift_m", self.lift_m, *self.limits.z_m)
        for name, high in (("lead_m", 1.0), ("segment_m", 1.0), ("settle_s", 10.0)):
            check_range("stage", name, getattr(self, name), 0.0, high)
        for name in ("stale_s", "timeout_s", "home_timeout_s"):  # 0 s of silence would be any silence
            check_range("stage", name, getattr(self, name), 1e-3, 600.0)
        check_range("stage", "poll_hz", self.poll_hz, 1.0, 500.0)
        count = len(self.axes)
        one_each = count == len(set(self.axes)) == len(self.origin_m) == len(self.sign)
        if count not in (2, 3) or not one_each or any(s not in (1, -1) for s in self.sign):
            raise DeviceError(
                f"stage: axes {self.axes}, origin_m {self.origin_m}, sign {self.sign}; two or three names,"
                " and a position and +1 or -1 for each"
            )
        self._host = HostTime()
        self._monitor = HealthMonitor(self.stale_s)
        self._motion: aerotech_motion.Motion | None = None

    @property
    def moves_across(self) -> bool:
        """Whether a third axis is named."""
        return len(self.axes) == 3

    def open(self, now_ns: int, state: AerotechState, rng: np.random.Generator) -> None:
        """Connect, enable, and bring a fresh stage home, raised, to y = 0 and x = 0."""
        self._host.observe(now_ns)
        if self._motion is not None:
            raise DeviceError("stage: open already; close it first")
        warn_unverified("stage", self.UNVERIFIED, self.verified)
        link = AerotechLink(self.url, self.baud, self.timeout_s)
        axes = aerotech_motion.ControllerAxes(link, self.axes, self._host)
        motion = aerotech_motion.Motion(link, axes, self._host, self._monitor, self.poll_hz)
        try:
            link.guard(self.axes)
            axes.enable()
            self._accel_m_per_s2 = 1e-3 * link.number(
                f"GETPARM({self.axes[0]}, {wire.Parameter.DEFAULT_RAMP_RATE})"
            )
            check_range("stage", "ramp rate read from the controller, m/s^2", self._accel_m_per_s2, 1e-6, 1e3)
            if not axes.homed():
                if not self.home_on_open:
                    raise DeviceError("stage: not homed; home it at the controller, or set home_on_open")
                axes.home(self.home_timeout_s, 1.0 / self.poll_hz)
                state.homed = False
            motion.start()
        except BaseException:
            link.close()
            raise
        self._motion = motion
        if not state.homed:
            try:
                legs = self._way_home(motion.history.last)
                self._follow(motion, legs)
            except DeviceError:
                self.close()
                raise
            if not motion.wait(self._duration_s(legs) * 1.5 + 5.0):
                self.close()
                raise DeviceError("stage: did not reach its place of rest after homing; check for faults")
            state.homed = True

    def close(self) -> None:
        """Release the link; a leg under way ends at its end."""
        if self._motion is not None:
            self._motion.stop_polling()
            self._motion = None

    def health(self, now_ns: int) -> DeviceHealth:
        self._host.observe(now_ns)
        return self._monitor.read(self._host.now_ns())

    def sweep_start(self, from_m: float, to_m: float) -> float:
        """Return the y from which a sweep reaches its speed ``lead_m`` before ``from_m``, in m."""
        return from_m - math.copysign(self._run_up_m(), to_m - from_m)

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: AerotechState) -> SweepTimes:
        """Sweep from here, at constant speed all the way from ``from_m`` to ``to_m``."""
        motion, (y_m, z_m, _) = self._resting(now_ns, state)
        speed = self.sweep_speed_m_per_s
        end_m = self.limits.sweep_end(y_m, z_m, from_m, to_m, self._run_up_m(), _PLACE_M)
        leg = self._leg("y", y_m, end_m, speed)
        started_ns = self._follow(motion, [leg])
        if self.segment_m > 0.0:  # it stops and goes: only its ends are predicted
            end_ns = started_ns + round(self._duration_s([leg]) * 1e9)
            return SweepTimes(started_ns, end_ns, end_ns)
        profile = MotionProfile(y_m, end_m, speed, self._accel_m_per_s2, started_ns)
        return SweepTimes(*profile.interval_ns(from_m, to_m), profile.end_ns + round(self.settle_s * 1e9))

    def return_to(
        self,
        y_m: float,
        now_ns: int,
        state: AerotechState,
        *,
        height_m: float = 0.0,
        across_m: float | None = None,
    ) -> int:
        """Raise, go across and to ``y_m``, lower; return the predicted arrival, ns; errors as of a sweep."""
        motion, (here_y, here_z, here_x) = self._resting(now_ns, state)
        check_range("stage", "y_m", y_m, *self.limits.y_m)
        above, sideways = max(self.lift_m, here_z), self.return_speed_m_per_s
        legs = [self._leg("z", here_z, above, self.lift_speed_m_per_s)]
        if across_m is not None:
            self.limits.check_across(across_m)
            legs.append(self._leg("x", here_x, across_m, sideways, raised=True))
        legs.append(self._leg("y", here_y, y_m, sideways, raised=True))
        legs.append(self._leg("z", above, height_m, self.lift_speed_m_per_s))
        return self._follow(motion, legs) + round(self._duration_s(legs) * 1e9)

    def retreat(self, speed_m_per_s: float, now_ns: int, state: AerotechState) -> int:
        """Raise to ``lift_m``; return the predicted time of arrival in ns; errors as for a sweep."""
        motion, (_, z_m, _) = self._resting(now_ns, state)
        legs = [self._leg("z", z_m, max(z_m, self.lift_m), speed_m_per_s)]
        return self._follow(motion, legs) + round(self._duration_s(legs) * 1e9)

    def stop(self, now_ns: int, state: AerotechState) -> int:
        """Abort every axis at once, whatever it was doing; return the predicted time of rest in ns."""
        self._host.observe(now_ns)
        if self._motion is not None:
            self._motion.abort()
        return self._host.now_ns() + round(self.settle_s * 1e9)

    def acknowledge(self, now_ns: int, state: AerotechState) -> None:
        """Clear latched faults and enable again: the operator's step after a trip, never the driver's own."""
        self._host.observe(now_ns)
        self._opened().acknowledge()

    def read(self, times_ns: Int64Array, state: AerotechState) -> StageReading:
        """Return positions at times, from the polls around them; at most ``stale_s`` beyond the last one."""
        motion = self._opened()
        positions = motion.history.at(times_ns, self.stale_s, moving=motion.on_leg)
        return StageReading(*(self._place(axis, positions[axis]) for axis in (0, 1)))

    def feedback(self, now_ns: int, state: AerotechState) -> StageFeedback:
        """Return where the last poll found the stage, and whether legs are under way or waiting."""
        motion = self._opened()
        controller_mm, speed_mm_per_s, asked_ns, answered_ns = motion.history.measured()
        y_m, z_m, x_m = self._places(controller_mm)
        return StageFeedback(y_m, z_m, speed_mm_per_s * 1e-3, motion.busy, asked_ns, answered_ns, x_m)

    def stop_link(
        self, url: str, *, timeout_s: float, look_hz: float, clock: Callable[[], int]
    ) -> AerotechStop:
        """Open a second link to this controller; errors as of :class:`.OpenStopLink`."""
        return AerotechStop(
            url,
            self.axes,
            self.baud,
            origin_m=self.origin_m,
            sign=self.sign,
            timeout_s=timeout_s,
            look_hz=look_hz,
            clock=clock,
        )

    def discover(self) -> dict[str, str]:
        """Return how each axis does; nothing but questions is sent."""
        link = AerotechLink(self.url, self.baud, self.timeout_s)
        try:
            return {axis: aerotech_motion.axis_in_words(link, axis) for axis in self.axes}
        finally:
            link.close()

    def _run_up_m(self) -> float:
        accel_m_per_s2 = getattr(self, "_accel_m_per_s2", 1.0)
        return float(self.sweep_speed_m_per_s**2 / (2.0 * accel_m_per_s2)) + self.lead_m

    def _opened(self) -> aerotech_motion.Motion:
        if self._motion is None:
            raise DeviceError("stage: not open; open it first")
        return self._motion

    def _resting(
        self, now_ns: int, state: AerotechState
    ) -> tuple[aerotech_motion.Motion, tuple[float, float, float]]:
        """Return the motion and where the stage rests: y, z and x, m."""
        self._host.observe(now_ns)
        motion, health = self._opened(), self.health(now_ns)
        if not health.ok:
            raise DeviceError(
                f"stage: {health.condition}: {health.cause}; clear it and acknowledge before a move"
            )
        if not state.homed:
            raise DeviceError("stage: not homed; open it with a fresh state")
        if motion.busy:
            raise DeviceError("stage: moves; wait for the end or stop it first")
        return motion, self._places(motion.history.last)

    def _places(self, controller_mm: tuple[float, ...]) -> tuple[float, float, float]:
        """Return y, z and x in m; x is 0 without a third axis."""
        y_m, z_m, *across_m = (float(self._place(i, value)) for i, value in enumerate(controller_mm))
        return y_m, z_m, across_m[0] if across_m else 0.0

    def _place(self, axis: int, controller_mm: np.ndarray | float) -> np.ndarray:
        return wire.place_m(np.asarray(controller_mm), self.origin_m[axis], self.sign[axis])

    def _way_home(self, controller_mm: tuple[float, ...]) -> list[aerotech_motion.Leg]:
        y_m, z_m, x_m = self._places(controller_mm)
        legs = [self._leg("z", z_m, self.lift_m, self.lift_speed_m_per_s)]
        if self.moves_across:
            legs.append(self._leg("x", x_m, 0.0, self.return_speed_m_per_s, raised=True))
        return [*legs, self._leg("y", y_m, 0.0, self.return_speed_m_per_s, raised=True)]

    def _leg(
        self, direction: Direction, from_m: float, to_m: float, speed_m_per_s: float, *, raised: bool = False
    ) -> aerotech_motion.Leg:
        """Return a leg that is within the limits; the check comes before anything is sent.

        ``raised``: it may begin and go on only while the measured height is that of the way back.
        """
        self.limits.check(direction, from_m, to_m, speed_m_per_s)
        number = get_args(Direction).index(direction)
        start_mm, target_mm = (self._controller_mm(number, place_m) for place_m in (from_m, to_m))
        low_mm, high_mm = sorted((self._controller_mm(1, self.lift_m - _SINKS_M), self.sign[1] * math.inf))
        return aerotech_motion.Leg(
            self.axes[number],
            start_mm,
            target_mm,
            1e3 * speed_m_per_s,
            abs(to_m - from_m),
            (low_mm, high_mm) if raised else None,
        )

    def _controller_mm(self, axis: int, place_m: float) -> float:
        return 1e3 * (self.sign[axis] * place_m + self.origin_m[axis])

    def _follow(self, motion: aerotech_motion.Motion, legs: list[aerotech_motion.Leg]) -> int:
        return motion.follow(
            aerotech_motion.in_segments([leg for leg in legs if leg.length_m > _NO_WAY_M], self.segment_m)
        )

    def _duration_s(self, legs: list[aerotech_motion.Leg]) -> float:
        return aerotech_motion.duration_s(
            aerotech_motion.in_segments(legs, self.segment_m), self._accel_m_per_s2, self.settle_s
        )
