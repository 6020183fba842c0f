"""What a search knows before it begins: the square, the lanes over it, what differs, and when it ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Lane:
    """A sweep along y at one place across."""

    x_m: float  # place across the lanes, from the middle of the square
    forward: bool = True  # whether it is swept towards +y
    ring_m: float = 0.016  # nominal position of the ring


class LaneRead(msgspec.Struct, frozen=True):
    """A lane and what was read along it; plain data, from which a replacement has the whole belief."""

    x_m: float
    forward: bool
    ring_m: float
    torque_n_m: list[float]  # means of the bins in the order of the sweep, with the sign of the rig

    @property
    def lane(self) -> Lane:
        """The lane."""
        return Lane(self.x_m, self.forward, self.ring_m)


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Parameters of a search, SI; spreads are standard deviations.

    Places are from the middle of the square. A lane is lowered ``run_in_m`` before its first bin; towards -y
    all of it is mirrored.
    """

    half_m: float = 0.050  # half of the square's side
    cell_m: float = 0.002  # of the map, and the length of a bin
    bins: int = 53  # of a lane
    first_m: float = -0.038  # stage position at which the first bin begins
    run_in_m: float = 0.024  # way of the stage before it: the tip sticks, lags and slides
    depths_m: tuple[float, ...] = tuple(1e-3 * d for d in (1, 1.5, 2, 2.5, 3, 3.5, 4, 5, 6, 7, 8, 9, 10))
    rings_m: tuple[float, ...] = (0.016,)  # rings that lanes may use
    speed_m_s: float = 0.02  # of the stage along a lane
    return_speed_m_s: float = 0.05  # of the raised stage
    lift_s: float = 2.0  # raise and lower, together
    spreads: tuple[float, ...] = (0.22e-3, 0.063, 0.05, 0.173e-3)  # height, modulus, friction, landing
    tilt_sd: float = 0.002  # rise of the surface per metre, each way
    friction: float = 0.3  # nominal coefficient
    texture_sd_n_m: float = 0.2e-3  # of the torque that the surface adds
    texture_length_m: float = 0.003
    hum_sd_n_m: float = 0.1e-3  # of what a bin's mean leaves of stick-slip
    hum_m: tuple[float, float] = (1.1e-3, 1.42e-3)  # least and largest way of the stage in one of its cycles
    white_sd_n_m: float = 0.05e-3  # of a bin: sensor, and what the mechanics leave out
    lane_sd_n_m: float = 0.05e-3  # of a lane's zero
    amplitude_sd: float = 0.08  # of a bead's signal in the map, for what its slopes would say
    none: float = 0.5  # probability that there is no bead
    second: float = 0.03  # probability of a second bead where there is one
    missed: float = 0.05  # that of a second one, above which one is not named alone
    sure: float = 0.99  # probability at which presence is decided
    place_sd_m: float = 0.5e-3  # place known so well, each way, ends a search
    depth_sd_m: float = 0.4e-3  # and depth so well
    most_s: float = 108.0  # no further lane begins after that
    misfit: float = 1e-3  # probability below which lanes do not fit what was trained
    policy: str = "greedy"

    def __post_init__(self) -> None:
        steps = self.half_m / self.cell_m
        if abs(steps - round(steps)) > 1e-6 or not 2 <= self.bins <= 1000:
            raise PerceptionError(
                f"cells of {self.cell_m} m in a square of {2 * self.half_m} m: use cells that divide its half"
            )
        if not 0.0 < self.none < 1.0 or not 0.0 <= self.second < 1.0 or not self.rings_m:
            raise PerceptionError("a search needs a ring, and probabilities between 0 and 1")
        if min(self.texture_sd_n_m, self.white_sd_n_m) <= 0.0:
            raise PerceptionError("a search needs the texture's and the bins' spread; give both above 0")

    @cached_property
    def cells_m(self) -> Float64Array:
        """Middles of the map's cells, alike across and along."""
        count = round(self.half_m / self.cell_m)
        return np.asarray(self.cell_m * np.arange(-count, count + 1))

    @cached_property
    def bins_m(self) -> Float64Array:
        """Middles of a lane's bins, on a lane towards +y."""
        return np.asarray(self.first_m + self.cell_m * (np.arange(self.bins) + 0.5))

    def path_m(self, lane: Lane) -> tuple[float, float, float]:
        """Return where a lane is lowered, where its first bin begins and where its last ends."""
        way = 1.0 if lane.forward else -1.0
        last_m = self.first_m + self.bins * self.cell_m
        return way * (self.first_m - self.run_in_m), way * self.first_m, way * last_m

    def lane_s(self, lane: Lane, after: Lane | None) -> float:
        """Return the seconds that a lane takes: raise, go there, lower, sweep."""
        begin_m, _, end_m = self.path_m(lane)
        way_m = 0.0
        if after is not None:
            way_m = max(abs(begin_m - self.path_m(after)[2]), abs(lane.x_m - after.x_m))
        return self.lift_s + way_m / self.return_speed_m_s + abs(end_m - begin_m) / self.speed_m_s
