"""A simulated stage: sweep along y at constant speed, return above the tissue, move across by x.

y runs along the sweep; z = 0 is the height of the sweep and z > 0 is away from the tissue; x runs across.
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
        x_m: Places of these corners across the sweep.
        speeds_m_per_s: Speed limit of each leg, one fewer than corners; every corner is a stop.
        accel_m_per_s2: Acceleration of the whole path.
        entry_speed_m_per_s: Speed at the start of the path; other than 0 only while stopping.
        start_ns: When the path starts.
    """

    homed: bool = False
    y_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
    z_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
    x_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
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
        accel_m_per_s2: Acceleration of each axis (assumed; the maker's limit is about 1 g).
        lead_m: Way at constant speed before and after the interval of a sweep (assumed).
        return_speed_m_per_s: Speed along y and x on the way back (assumed).
        lift_speed_m_per_s: Speed of raising and lowering (assumed).
        lift_m: Height of the way back (assumed: clears the tissue).
        limits: Travel and speed (assumed: the variant with 110 mm, origin in its middle).
        resolution_m: Step of the position (the paper: 1 nm); 0 for none.
    """

    state_type: ClassVar[type[SimStageState]] = SimStageState
    stop_link: ClassVar[None] = None
    moves_across: ClassVar[bool] = True

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
            self._follow(state, [(0.0, self.lift_m, 0.0)], [], now_ns)
            state.homed = True

    def sweep_start(self, from_m: float, to_m: float) -> float:
        """Return the y from which a sweep reaches its speed ``lead_m`` before ``from_m``, in m."""
        return from_m - math.copysign(self._run_up_m, to_m - from_m)

    @property
    def _run_up_m(self) -> float:
        return self.sweep_speed_m_per_s**2 / (2.0 * self.accel_m_per_s2) + self.lead_m

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: SimStageState) -> SweepTimes:
        """Sweep from the present place, at constant speed all the way from ``from_m`` to ``to_m``."""
        y_m, z_m, x_m = self._resting_place(now_ns, state)
        end_m = self.limits.sweep_end(y_m, z_m, from_m, to_m, self._run_up_m, _TOLERANCE_M)
        profile = MotionProfile(y_m, end_m, self.sweep_speed_m_per_s, self.accel_m_per_s2, now_ns)
        times = SweepTimes(*profile.interval_ns(from_m, to_m), profile.end_ns)
        self._follow(state, [(y_m, z_m, x_m), (end_m, z_m, x_m)], [self.sweep_speed_m_per_s], now_ns)
        return times

    def return_to(
        self,
        y_m: float,
        now_ns: int,
        state: SimStageState,
        *,
        height_m: float = 0.0,
        across_m: float | None = None,
    ) -> int:
        """Raise, go across and to ``y_m``, lower to the height of the sweep; return the arrival in ns."""
        here_y, here_z, here_x = self._resting_place(now_ns, state)
        x_m = here_x if across_m is None else across_m
        check_range("stage", "y_m", y_m, *self.limits.y_m)
        self.limits.check_across(x_m)
        check_range("stage", "height_m", height_m, self.limits.z_m[0], self.lift_m)
        above = max(self.lift_m, here_z)
        corners = [
            (here_y, here_z, here_x), (here_y, above, here_x), (here_y, above, x_m), (y_m, above, x_m),
            (y_m, height_m, x_m),
        ]  # fmt: skip
        lift, sideways = self.lift_speed_m_per_s, self.return_speed_m_per_s
        self._follow(state, corners, [lift, sideways, sideways, lift], now_ns)
        return path_end_ns(state)

    def retreat(self, speed_m_per_s: float, now_ns: int, state: SimStageState) -> int:
        """Raise to ``lift_m``; return the time of arrival in ns."""
        y_m, z_m, x_m = self._resting_place(now_ns, state)
        self._follow(state, [(y_m, z_m, x_m), (y_m, max(z_m, self.lift_m), x_m)], [speed_m_per_s], now_ns)
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
        y, z, x = (float(places[0]) for places in _positions(now, state))
        speed = profile.velocity(now_ns)
        way_m, length_m = speed**2 / (2.0 * state.accel_m_per_s2), profile.end_m
        end_y, end_z, end_x = (
            here + way_m * (corners[leg + 1] - corners[leg]) / length_m
            for here, corners in ((y, state.y_m), (z, state.z_m), (x, state.x_m))
        )
        if way_m < _TOLERANCE_M:
            self._follow(state, [(y, z, x)], [], now_ns)
            return now_ns
        self._follow(state, [(y, z, x), (end_y, end_z, end_x)], [speed], now_ns)
        state.entry_speed_m_per_s = math.sqrt(
            2.0 * state.accel_m_per_s2 * math.hypot(end_y - y, end_z - z, end_x - x)
        )
        state.speeds_m_per_s = [max(speed, state.entry_speed_m_per_s)]
        return path_end_ns(state)

    def feedback(self, now_ns: int, state: SimStageState) -> StageFeedback:
        """Return where it is, how fast, and whether its path has not ended yet."""
        now = np.array([now_ns])
        y_m, z_m, x_m = (float(self._rounded(places)[0]) for places in _positions(now, state))
        speed_m_per_s = max((abs(p.velocity(now_ns)) for p in _profiles(state)), default=0.0)
        moving = now_ns < path_end_ns(state)
        return StageFeedback(y_m, z_m, speed_m_per_s, moving, now_ns, now_ns, x_m)

    def read(self, times_ns: Int64Array, state: SimStageState) -> StageReading:
        """Return the positions at ``times_ns``, shape (n,), in steps of the resolution."""
        y_m, z_m, _ = _positions(times_ns, state)
        return StageReading(self._rounded(y_m), self._rounded(z_m))

    def _rounded(self, position_m: Float64Array) -> Float64Array:
        if self.resolution_m == 0.0:
            return position_m
        return np.rint(position_m / self.resolution_m) * self.resolution_m

    def _resting_place(self, now_ns: int, state: SimStageState) -> tuple[float, float, float]:
        if not state.homed:
            raise DeviceError("stage: not homed; open it before the first move")
        if now_ns < (end_ns := path_end_ns(state)):
            raise DeviceError(
                f"stage: moves for another {(end_ns - now_ns) * 1e-9:.3f} s; wait or stop it first"
            )
        return state.y_m[-1], state.z_m[-1], state.x_m[-1]

    def _follow(
        self,
        state: SimStageState,
        corners: list[tuple[float, float, float]],
        speeds: list[float],
        now_ns: int,
    ) -> None:
        """Write a path into the state, leaving out legs of no length."""
        kept = [leg for leg, (a, b) in enumerate(pairwise(corners)) if a != b]
        path = [corners[0], *(corners[leg + 1] for leg in kept)]
        state.y_m, state.z_m, state.x_m = (list(places) for places in zip(*path, strict=True))
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
    corners = pairwise(zip(state.y_m, state.z_m, state.x_m, strict=True))
    for (before, after), speed in zip(corners, state.speeds_m_per_s, strict=True):
        profile = _leg(math.dist(before, after), speed, state.accel_m_per_s2, start_ns, entry)
        profiles.append(profile)
        start_ns, entry = profile.end_ns, 0.0
    return profiles


def _positions(times_ns: Int64Array, state: SimStageState) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return y, z and x at times, each of shape (n,), m."""
    ways = (state.y_m, state.z_m, state.x_m)
    y_m, z_m, x_m = (np.full(np.shape(times_ns), corners[0]) for corners in ways)
    for leg, profile in enumerate(_profiles(state)):
        done = profile.position(times_ns) / profile.end_m
        for places, corners in zip((y_m, z_m, x_m), ways, strict=True):
            places += done * (corners[leg + 1] - corners[leg])
    return y_m, z_m, x_m
