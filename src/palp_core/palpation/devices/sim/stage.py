"""A simulated two-axis stage: sweep along y at constant speed, return above the tissue.

y runs along the sweep; z = 0 is the height of the sweep and z > 0 is away from the tissue.
"""

import functools
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import TravelLimits, check_range
from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.protocols import Int64Array, StageFeedback, StageReading, SweepTimes
from palp_core.palpation.devices.sim import Simulated
from palp_core.units import Float64Array

_TOLERANCE_M = 1e-12  # rounding of a double, far below the resolution
_TOP_SPEED_M_PER_S = 0.350  # of the ANT130


class SimStageState(msgspec.Struct):
    """The path under way or, when its time is over, the place where the stage rests at its end.

    Attributes:
        homed: Whether the stage knows where it is; it refuses to move before.
        y_m: Corners of the path, from where it starts to where it ends.
        z_m: Heights of these corners.
        speeds_m_per_s: Speed limit of each leg, one fewer than corners; every corner is a stop.
        accel_m_per_s2: Acceleration of the whole path.
        entry_speed_m_per_s: Speed at the start of the path; other than 0 only while stopping.
        start_ns: When the path starts.
    """

    homed: bool = False
    y_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
    z_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
    speeds_m_per_s: list[float] = []
    accel_m_per_s2: float = 1.0
    entry_speed_m_per_s: float = 0.0
    start_ns: int = 0


_TRAVEL = TravelLimits(speed_m_per_s=_TOP_SPEED_M_PER_S)


@dataclass(frozen=True)
class SimStage(Simulated):
    """Parameters of a stage like the Aerotech ANT130.

    Attributes:
        sweep_speed_m_per_s: Speed over the tissue (the paper: 20 mm/s).
        accel_m_per_s2: Acceleration of both axes (assumed; the maker's limit is about 1 g).
        lead_m: Way at constant speed before and after the interval of a sweep (assumed).
        return_speed_m_per_s: Speed along y on the way back (assumed).
        lift_speed_m_per_s: Speed of raising and lowering (assumed).
        lift_m: Height of the way back (assumed: clears the tissue).
        limits: Travel and speed (assumed: the variant with 110 mm, origin in its middle).
        resolution_m: Step of the position (the paper: 1 nm); 0 for none.
    """

    state_type: ClassVar[type[SimStageState]] = SimStageState
    stop_link: ClassVar[None] = None

    sweep_speed_m_per_s: float = 0.020
    accel_m_per_s2: float = 1.0
    lead_m: float = 1e-3
    return_speed_m_per_s: float = 0.050
    lift_speed_m_per_s: float = 0.020
    lift_m: float = 0.020
    limits: TravelLimits = _TRAVEL
    resolution_m: float = 1e-9

    def __post_init__(self) -> None:
        for name in ("sweep_speed_m_per_s", "return_speed_m_per_s", "lift_speed_m_per_s"):
            check_range("stage", name, getattr(self, name), 1e-6, self.limits.speed_m_per_s)
        check_range("stage", "accel_m_per_s2", self.accel_m_per_s2, 1e-6, 9.81)
        check_range("stage", "lead_m", self.lead_m, 0.0, 1.0)
        check_range("stage", "lift_m", self.lift_m, *self.limits.z_m)
        check_range("stage", "resolution_m", self.resolution_m, 0.0, 1e-3)

    def open(self, now_ns: int, state: SimStageState, rng: np.random.Generator) -> None:
        """Home a fresh stage to y = 0, raised; leave one that was homed before as it is."""
        if not state.homed:
            self._rest(state, 0.0, self.lift_m, now_ns)
            state.homed = True

    def sweep_start(self, from_m: float, to_m: float) -> float:
        """Return the y from which a sweep reaches its speed ``lead_m`` before ``from_m``, in m."""
        return from_m - math.copysign(self._run_up_m, to_m - from_m)

    @property
    def _run_up_m(self) -> float:
        return self.sweep_speed_m_per_s**2 / (2.0 * self.accel_m_per_s2) + self.lead_m

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: SimStageState) -> SweepTimes:
        """Sweep from the present place, at constant speed all the way from ``from_m`` to ``to_m``."""
        y_m, z_m = self._resting_place(now_ns, state)
        end_m = self.limits.sweep_end(y_m, z_m, from_m, to_m, self._run_up_m, _TOLERANCE_M)
        profile = MotionProfile(y_m, end_m, self.sweep_speed_m_per_s, self.accel_m_per_s2, now_ns)
        times = SweepTimes(*profile.interval_ns(from_m, to_m), profile.end_ns)
        self._follow(state, [(y_m, z_m), (end_m, z_m)], [self.sweep_speed_m_per_s], now_ns)
        return times

    def return_to(self, y_m: float, now_ns: int, state: SimStageState, *, height_m: float = 0.0) -> int:
        """Raise, go to ``y_m`` and lower to the height of the sweep; return the time of arrival in ns."""
        here_y, here_z = self._resting_place(now_ns, state)
        check_range("stage", "y_m", y_m, *self.limits.y_m)
        check_range("stage", "height_m", height_m, self.limits.z_m[0], self.lift_m)
        above = max(self.lift_m, here_z)
        corners = [(here_y, here_z), (here_y, above), (y_m, above), (y_m, height_m)]
        speeds = [self.lift_speed_m_per_s, self.return_speed_m_per_s, self.lift_speed_m_per_s]
        self._follow(state, corners, speeds, now_ns)
        return path_end_ns(state)

    def retreat(self, speed_m_per_s: float, now_ns: int, state: SimStageState) -> int:
        """Raise to ``lift_m``; return the time of arrival in ns."""
        y_m, z_m = self._resting_place(now_ns, state)
        self._follow(state, [(y_m, z_m), (y_m, max(z_m, self.lift_m))], [speed_m_per_s], now_ns)
        return path_end_ns(state)

    def stop(self, now_ns: int, state: SimStageState) -> int:
        """Decelerate to rest along the present leg; return the time of rest in ns."""
        under_way = [
            (leg, profile)
            for leg, profile in enumerate(_profiles(state))
            if profile.start_ns <= now_ns < profile.end_ns
        ]
        if not under_way:
            return now_ns
        leg, profile = under_way[0]
        now = np.array([now_ns])
        y, z = _positions(now, state)
        speed, y_m, z_m = profile.velocity(now_ns), float(y[0]), float(z[0])
        way_m, length_m = speed**2 / (2.0 * state.accel_m_per_s2), profile.end_m
        end_y = y_m + way_m * (state.y_m[leg + 1] - state.y_m[leg]) / length_m
        end_z = z_m + way_m * (state.z_m[leg + 1] - state.z_m[leg]) / length_m
        if way_m < _TOLERANCE_M:
            self._rest(state, y_m, z_m, now_ns)
            return now_ns
        self._follow(state, [(y_m, z_m), (end_y, end_z)], [speed], now_ns)
        state.entry_speed_m_per_s = math.sqrt(
            2.0 * state.accel_m_per_s2 * math.hypot(end_y - y_m, end_z - z_m)
        )
        state.speeds_m_per_s = [max(speed, state.entry_speed_m_per_s)]
        return path_end_ns(state)

    def feedback(self, now_ns: int, state: SimStageState) -> StageFeedback:
        """Return where it is, how fast, and whether its path has not ended yet."""
        now = np.array([now_ns])
        place = self.read(now, state)
        speed_m_per_s = max((abs(p.velocity(now_ns)) for p in _profiles(state)), default=0.0)
        moving = now_ns < path_end_ns(state)
        return StageFeedback(float(place.y_m[0]), float(place.z_m[0]), speed_m_per_s, moving, now_ns, now_ns)

    def read(self, times_ns: Int64Array, state: SimStageState) -> StageReading:
        """Return the positions at ``times_ns``, shape (n,), in steps of the resolution."""
        y_m, z_m = _positions(times_ns, state)
        return StageReading(self._rounded(y_m), self._rounded(z_m))

    def _rounded(self, position_m: Float64Array) -> Float64Array:
        if self.resolution_m == 0.0:
            return position_m
        return np.rint(position_m / self.resolution_m) * self.resolution_m

    def _resting_place(self, now_ns: int, state: SimStageState) -> tuple[float, float]:
        if not state.homed:
            raise DeviceError("stage: not homed; open it before the first move")
        if now_ns < (end_ns := path_end_ns(state)):
            raise DeviceError(
                f"stage: moves for another {(end_ns - now_ns) * 1e-9:.3f} s; wait or stop it first"
            )
        return state.y_m[-1], state.z_m[-1]

    def _rest(self, state: SimStageState, y_m: float, z_m: float, now_ns: int) -> None:
        self._follow(state, [(y_m, z_m)], [], now_ns)

    def _follow(
        self, state: SimStageState, corners: list[tuple[float, float]], speeds: list[float], now_ns: int
    ) -> None:
        """Write a path into the state, leaving out legs of no length."""
        kept = [leg for leg, (a, b) in enumerate(pairwise(corners)) if a != b]
        path = [corners[0], *(corners[leg + 1] for leg in kept)]
        state.y_m = [y for y, _ in path]
        state.z_m = [z for _, z in path]
        state.speeds_m_per_s = [speeds[leg] for leg in kept]
        state.accel_m_per_s2 = self.accel_m_per_s2
        state.entry_speed_m_per_s = 0.0
        state.start_ns = now_ns


def path_end_ns(state: SimStageState) -> int:
    """Return the time at which the stage comes, or came, to rest."""
    return max((profile.end_ns for profile in _profiles(state)), default=state.start_ns)


@functools.lru_cache(maxsize=8)  # a path is asked for at each block of poses, at its begin and at its end
def _leg(length_m: float, speed: float, accel: float, start_ns: int, entry_speed: float) -> MotionProfile:
    return MotionProfile(0.0, length_m, speed, accel, start_ns, entry_speed)


def _profiles(state: SimStageState) -> list[MotionProfile]:
    """Return one profile per leg of the path, over the way along that leg from 0 to its length."""
    profiles: list[MotionProfile] = []
    start_ns, entry = state.start_ns, state.entry_speed_m_per_s
    corners = zip(pairwise(state.y_m), pairwise(state.z_m), state.speeds_m_per_s, strict=True)
    for (y0, y1), (z0, z1), speed in corners:
        profile = _leg(math.hypot(y1 - y0, z1 - z0), speed, state.accel_m_per_s2, start_ns, entry)
        profiles.append(profile)
        start_ns, entry = profile.end_ns, 0.0
    return profiles


def _positions(times_ns: Int64Array, state: SimStageState) -> tuple[Float64Array, Float64Array]:
    y_m = np.full(np.shape(times_ns), state.y_m[0])
    z_m = np.full(np.shape(times_ns), state.z_m[0])
    for leg, profile in enumerate(_profiles(state)):
        done = profile.position(times_ns) / profile.end_m
        y_m += done * (state.y_m[leg + 1] - state.y_m[leg])
        z_m += done * (state.z_m[leg + 1] - state.z_m[leg])
    return y_m, z_m
