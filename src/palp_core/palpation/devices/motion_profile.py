"""A straight move with finite acceleration: speed up, cruise, slow down."""

import math
from dataclasses import dataclass, field

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import Int64Array
from palp_core.units import Float64Array

_NS = 1e9
_ROUNDING_M = 1e-12
_LIMIT = 1e3  # m, m/s, m/s^2: far beyond any stage, to refuse infinity and mistaken units


@dataclass(frozen=True)
class MotionProfile:
    """Position against time of a move from ``start_m`` to rest at ``end_m``.

    The speed is a trapezoid: it rises from the entry speed at ``accel_m_per_s2``, stays at ``speed_m_per_s``,
    and falls to zero at the same rate; a move too short to reach the speed is a triangle. With entry speed
    v0, distance L and acceleration a, energy at constant acceleration gives the peak speed min(v, sqrt(a L +
    v0^2 / 2)).

    Attributes:
        start_m: Position at ``start_ns`` and before.
        end_m: Position at ``end_ns`` and after, exactly.
        speed_m_per_s: Speed limit, > 0.
        accel_m_per_s2: Magnitude of acceleration and deceleration, > 0.
        start_ns: Time at which the move starts.
        entry_speed_m_per_s: Speed at ``start_ns``, towards ``end_m``; 0 for a start from rest.
    """

    start_m: float
    end_m: float
    speed_m_per_s: float
    accel_m_per_s2: float
    start_ns: int
    entry_speed_m_per_s: float = 0.0
    end_ns: int = field(init=False)
    _peak_m_per_s: float = field(init=False, repr=False)
    _speed_up_s: float = field(init=False, repr=False)
    _slow_down_s: float = field(init=False, repr=False)  # time at which slowing down begins
    _duration_s: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_range("move", "start_m", self.start_m, -_LIMIT, _LIMIT)
        check_range("move", "end_m", self.end_m, -_LIMIT, _LIMIT)
        check_range("move", "speed_m_per_s", self.speed_m_per_s, 1e-9, _LIMIT)
        check_range("move", "accel_m_per_s2", self.accel_m_per_s2, 1e-9, _LIMIT)
        check_range("move", "entry_speed_m_per_s", self.entry_speed_m_per_s, 0.0, self.speed_m_per_s)
        entry, accel, distance = self.entry_speed_m_per_s, self.accel_m_per_s2, abs(self.end_m - self.start_m)
        if entry**2 / (2.0 * accel) > distance + _ROUNDING_M:
            raise DeviceError(
                f"move: {distance:g} m is too short to stop from {entry:g} m/s at {accel:g} m/s^2;"
                " move farther or decelerate more"
            )
        peak = max(entry, min(self.speed_m_per_s, math.sqrt(accel * distance + entry**2 / 2.0)))
        cruise_m = max(0.0, distance - (2.0 * peak**2 - entry**2) / (2.0 * accel))
        speed_up_s = (peak - entry) / accel
        slow_down_s = speed_up_s + (cruise_m / peak if peak > 0.0 else 0.0)
        duration_s = slow_down_s + peak / accel
        derived = {
            "_peak_m_per_s": peak,
            "_speed_up_s": speed_up_s,
            "_slow_down_s": slow_down_s,
            "_duration_s": duration_s,
            "end_ns": self.start_ns + max(math.ceil(duration_s * _NS), int(distance > 0.0)),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    @property
    def _sign(self) -> float:
        return math.copysign(1.0, self.end_m - self.start_m)

    @property
    def _speed_up_m(self) -> float:
        return (self._peak_m_per_s**2 - self.entry_speed_m_per_s**2) / (2.0 * self.accel_m_per_s2)

    def position(self, times_ns: Int64Array) -> Float64Array:
        """Return the positions at ``times_ns``, shape (n,), in m."""
        t = np.clip((times_ns - self.start_ns) / _NS, 0.0, self._duration_s)
        accel = self.accel_m_per_s2
        speeding = self.start_m + self._sign * (self.entry_speed_m_per_s * t + accel * t**2 / 2.0)
        cruising = self.start_m + self._sign * (
            self._speed_up_m + self._peak_m_per_s * (t - self._speed_up_s)
        )
        slowing = self.end_m - self._sign * accel * (self._duration_s - t) ** 2 / 2.0
        moving = np.where(t < self._speed_up_s, speeding, np.where(t < self._slow_down_s, cruising, slowing))
        return np.where(
            times_ns <= self.start_ns, self.start_m, np.where(times_ns >= self.end_ns, self.end_m, moving)
        )

    def velocity(self, now_ns: int) -> float:
        """Return the signed velocity at a time, in m/s."""
        if not self.start_ns <= now_ns < self.end_ns:
            return 0.0
        t, accel = min((now_ns - self.start_ns) / _NS, self._duration_s), self.accel_m_per_s2
        speeding, slowing = self.entry_speed_m_per_s + accel * t, accel * (self._duration_s - t)
        return self._sign * min(self._peak_m_per_s, speeding, slowing)

    def crossing_s(self, position_m: float) -> float:
        """Return the time after ``start_ns`` at which the move passes ``position_m``, in s."""
        low, high = sorted((self.start_m, self.end_m))
        check_range("move", "position_m", position_m, low - _ROUNDING_M, high + _ROUNDING_M)
        gone_m, left_m = abs(position_m - self.start_m), abs(self.end_m - position_m)
        entry, accel = self.entry_speed_m_per_s, self.accel_m_per_s2
        if gone_m < self._speed_up_m:
            return (math.sqrt(entry**2 + 2.0 * accel * gone_m) - entry) / accel
        if left_m < self._peak_m_per_s**2 / (2.0 * accel):
            return self._duration_s - math.sqrt(2.0 * left_m / accel)
        return self._speed_up_s + (gone_m - self._speed_up_m) / max(self._peak_m_per_s, 1e-300)

    def interval_ns(self, from_m: float, to_m: float) -> tuple[int, int]:
        """Return the first and last whole nanosecond at which the move is between two positions."""
        enter_s, leave_s = self.crossing_s(from_m), self.crossing_s(to_m)
        if leave_s < enter_s:
            raise DeviceError(f"move: passes {to_m:g} m before {from_m:g} m; swap the ends of the interval")
        return self.start_ns + math.ceil(enter_s * _NS), self.start_ns + math.floor(leave_s * _NS)
