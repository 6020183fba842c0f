"""How long a palpation takes on the rig: the paper's cycle, and one without what nobody needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.studies.simulation.session import PATH_M, WorldPlan, WorldSession, begin
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Protocol:
    """The cycle of a palpation.

    Attributes:
        name: Of the protocol.
        path_m: Ends of the sweep.
        lift_m: Height of the way back.
        rehome: Whether the ring is re-homed before each trial.
        in_sweep: Whether a sweep ends once the belief is sure.
    """

    name: str
    path_m: tuple[float, float]
    lift_m: float
    rehome: bool
    in_sweep: bool

    @property
    def stage(self) -> SimStage:
        """The stage that runs it."""
        return SimStage(lift_m=self.lift_m)

    def sweep_s(self, way_m: Float64Array) -> Float64Array:
        """Return seconds from rest before the path to rest again, so much of it swept, shape (n,)."""
        stage = self.stage
        speed, accel = stage.sweep_speed_m_per_s, stage.accel_m_per_s2
        run_up_s = speed / accel + stage.lead_m / speed
        run_out_s = np.where(way_m < abs(self.path_m[1] - self.path_m[0]) - 1e-9, speed / accel, run_up_s)
        return np.asarray(run_up_s + way_m / speed + run_out_s)

    def back_s(self, way_m: Float64Array) -> Float64Array:
        """Return seconds to lift, go back over so much of the path, and lower, shape (n,)."""
        stage = self.stage
        up_s = _leg_s(self.lift_m, stage.lift_speed_m_per_s, stage.accel_m_per_s2)
        lead_m = 2.0 * stage.lead_m + stage.sweep_speed_m_per_s**2 / stage.accel_m_per_s2
        return np.array(
            [
                2.0 * up_s + _leg_s(float(m) + lead_m, stage.return_speed_m_per_s, stage.accel_m_per_s2)
                for m in np.atleast_1d(way_m)
            ]
        )

    @property
    def timing(self) -> Timing:
        """The timing of whole sweeps, for schemes of one number a sweep."""
        way = np.array([abs(self.path_m[1] - self.path_m[0])])
        return Timing(sweep_s=float(self.sweep_s(way)[0] + self.back_s(way)[0]), rehomes=self.rehome)


def _leg_s(length_m: float, speed_m_s: float, accel_m_s2: float) -> float:
    return (MotionProfile(0.0, length_m, speed_m_s, accel_m_s2, 0).end_ns) * 1e-9


PAPER_PROTOCOL = Protocol("paper", PATH_M, 0.020, rehome=True, in_sweep=False)
SWIFT = Protocol("swift", (-0.026, 0.034), 0.006, rehome=False, in_sweep=True)
"""The ball drags from its place of landing on, 26 mm before the bead: half is bare gel, by which friction,
height and modulus are known, half the bead's flank. At 34 mm it has passed the bead's other flank even where
it lags most. A lift of 6 mm clears an indentation of 4 mm."""


def sessions_by_protocol(plan: WorldPlan, seed: tuple[int, ...]) -> Callable[[Protocol], WorldSession]:
    """Return a session as any protocol sweeps it, made when it is asked for."""

    @cache
    def swept(protocol: Protocol) -> WorldSession:
        conditions = replace(plan.conditions, rehome=protocol.rehome)
        return begin(replace(plan, path_m=protocol.path_m, conditions=conditions), seed)

    return swept
