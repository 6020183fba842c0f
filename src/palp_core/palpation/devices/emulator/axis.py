"""The emulated axes of the stage: where each is, how it moves, what stops it."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.wire.aerotech import AxisStatus, Fault

_LOG_LENGTH = 100_000


@dataclass(frozen=True)
class AxisSettings:
    """Parameters of an axis; travel and accelerations are assumed, as the variant is not known.

    Attributes:
        soft_low_m: Software limit.
        soft_high_m: The other one.
        ramp_m_per_s2: Acceleration.
        abort_m_per_s2: Deceleration of ABORT.
        home_s: How long homing takes.
        home_m: Where its reference is; it is there before anything moves, too.
    """

    soft_low_m: float = -0.055
    soft_high_m: float = 0.055
    ramp_m_per_s2: float = 1.0
    abort_m_per_s2: float = 5.0
    home_s: float = 0.5
    home_m: float = 0.0


@dataclass
class Axis:
    """An axis at rest or on one straight move."""

    settings: AxisSettings
    enabled: bool = False
    homed: bool = False
    homing_until_ns: int = 0
    fault: int = 0
    estop: bool = False
    stuck: bool = False
    short: bool = False
    slips: bool = False
    profile: MotionProfile = field(default_factory=lambda: MotionProfile(0.0, 0.0, 1.0, 1.0, 0))

    def __post_init__(self) -> None:
        self._rest(self.settings.home_m, 0)

    def position_m(self, now_ns: int) -> float:
        """Return the position at a time."""
        if now_ns >= self.profile.end_ns:  # at rest, as it mostly is
            return self.profile.end_m
        return float(self.profile.position(np.array([now_ns]))[0])

    def velocity_m_per_s(self, now_ns: int) -> float:
        """Return the velocity at a time."""
        return self.profile.velocity(now_ns)

    def moving(self, now_ns: int) -> bool:
        """Return whether a move or homing is under way."""
        return now_ns < self.profile.end_ns or self.homing(now_ns)

    @property
    def rest_ns(self) -> int:
        """When the last move ends or ended."""
        return self.profile.end_ns

    def homing(self, now_ns: int) -> bool:
        """Return whether homing is under way; its end makes the axis homed."""
        if self.homing_until_ns and now_ns >= self.homing_until_ns:
            self.homing_until_ns, self.homed = 0, True
            self._rest(self.settings.home_m, now_ns)
        return self.homing_until_ns > 0

    def home(self, now_ns: int) -> bool:
        """Begin to home; return whether the axis can."""
        if not self.ready(now_ns):
            return False
        self.homing_until_ns = now_ns + max(1, round(self.settings.home_s * 1e9))
        return True

    def ready(self, now_ns: int) -> bool:
        """Return whether the axis takes a move."""
        return self.enabled and not self.fault and not self.moving(now_ns)

    def inside(self, target_m: float) -> bool:
        """Return whether a target is within the software limits; one outside of them is a fault."""
        if target_m > self.settings.soft_high_m:
            self.fault |= Fault.CW_SOFT_LIMIT
        elif target_m < self.settings.soft_low_m:
            self.fault |= Fault.CCW_SOFT_LIMIT
        else:
            return True
        return False

    def move(self, target_m: float, speed_m_per_s: float, now_ns: int) -> None:
        """Begin a move; a stuck axis ends it with a position error, a short one half-way without any."""
        if self.stuck:
            self.trip(Fault.POSITION_ERROR, now_ns)
            return
        start_m = self.position_m(now_ns)
        if self.short:
            target_m = 0.5 * (start_m + target_m)
        self.profile = MotionProfile(
            start_m, target_m, max(speed_m_per_s, 1e-6), self.settings.ramp_m_per_s2, now_ns
        )

    def abort(self, now_ns: int) -> None:
        """Slow down to rest."""
        self.homing_until_ns = 0
        self._slow_down(self.settings.abort_m_per_s2, now_ns)

    def trip(self, fault: Fault, now_ns: int) -> None:
        """Latch a fault and cut the power; the axis coasts to rest as ABORT would stop it (assumed)."""
        self.fault |= fault
        self.abort(now_ns)
        self.enabled = False

    def fall(self, to_m: float, now_ns: int) -> None:
        """Sink to a place by itself, at 50 mm/s, if it slips; only an abort ends that earlier."""
        if not self.slips:
            return
        self.profile = MotionProfile(self.position_m(now_ns), to_m, 0.05, self.settings.ramp_m_per_s2, now_ns)

    def status(self, now_ns: int) -> int:
        """Return the AXISSTATUS word as the signed number that the controller prints."""
        word, velocity = 0, self.velocity_m_per_s(now_ns)
        if self.enabled:
            word |= AxisStatus.ENABLED
        if self.homing(now_ns):
            word |= AxisStatus.HOMING | AxisStatus.MOVING
        elif self.enabled and not self.moving(now_ns):
            word |= AxisStatus.IN_POSITION
        if self.homed and not self.homing(now_ns):
            word |= AxisStatus.HOMED
        if now_ns < self.profile.end_ns:
            word |= AxisStatus.MOVING | self._phase(now_ns)
            if velocity > 0.0 or (velocity == 0.0 and self.profile.end_m > self.profile.start_m):
                word |= AxisStatus.DIRECTION
        if self.estop:
            word |= AxisStatus.ESTOP_INPUT
        return word - (1 << 32) if word >= 1 << 31 else int(word)

    def _phase(self, now_ns: int) -> int:
        later_ns = min(now_ns + 1_000_000, self.profile.end_ns - 1)
        change = abs(self.velocity_m_per_s(later_ns)) - abs(self.velocity_m_per_s(now_ns))
        if change > 1e-9:
            return AxisStatus.ACCELERATING
        return AxisStatus.DECELERATING if change < -1e-9 else 0

    def _slow_down(self, rate_m_per_s2: float, now_ns: int) -> None:
        here_m, velocity = self.position_m(now_ns), self.velocity_m_per_s(now_ns)
        if velocity == 0.0:
            self._rest(here_m, now_ns)
            return
        way_m = velocity * abs(velocity) / (2.0 * rate_m_per_s2)
        self.profile = MotionProfile(
            here_m, here_m + way_m, abs(velocity), rate_m_per_s2, now_ns, abs(velocity)
        )

    def _rest(self, position_m: float, now_ns: int) -> None:
        self.profile = MotionProfile(position_m, position_m, 1.0, 1.0, now_ns)


@dataclass
class Axes:
    """The axes of the stage, which every client of its controller commands."""

    y: Axis
    z: Axis
    x: Axis = field(default_factory=lambda: Axis(AxisSettings()))
    log: deque[tuple[int, int, str]] = field(default_factory=lambda: deque(maxlen=_LOG_LENGTH))
