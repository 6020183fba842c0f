"""How long a sweep keeps the rig, by the motion of its stage and its ring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.units import Float64Array


@dataclass(frozen=True)
class RigStanding:
    """Where a trial has left the rig; before its first sweep nothing counts.

    Attributes:
        stage_m: Stage position after the last sweep; None: lowered where the first will begin.
        ring_m: Position of the ring; None: at its stop, or wherever the trial before has left it.
        home_m: Stage position at which the first sweep began, and at which the next trial's will.
    """

    stage_m: float | None = None
    ring_m: float | None = None
    home_m: float | None = None


@dataclass(frozen=True)
class ActionTime:
    """The rig's own times. Trials begin alike: the way home leads to where the first sweep began.

    Attributes:
        stage: The stage; its sweeping speed is that of the action.
        ring: The ring's travel.
    """

    stage: SimStage
    ring: Timing

    def sweep_s(self, action: SweepAction, way_m: Float64Array) -> Float64Array:
        """Return seconds from rest before the path to rest again, so much of it swept, shape (n,)."""
        speed, accel = action.speed_m_per_s, self.stage.accel_m_per_s2
        run_up_s = speed / accel + self.stage.lead_m / speed
        run_out_s = np.where(way_m < action.way_m - 1e-9, speed / accel, run_up_s)
        return np.asarray(run_up_s + way_m / speed + run_out_s)

    def lands(self, action: SweepAction, at: RigStanding) -> bool:
        """Tell whether the ring comes anew to where an action wants it."""
        return at.ring_m != action.ring_m

    def to_s(self, action: SweepAction, at: RigStanding) -> float:
        """Return seconds until an action may begin: the ring's, then the stage's."""
        over_s = 0.0 if at.stage_m is None else self._over_s(at.stage_m, self._start_m(action))
        return self._ring_s(action.ring_m, at) + over_s

    def after(self, action: SweepAction, at: RigStanding) -> RigStanding:
        """Return where the rig is left by an action that was swept to its end."""
        end_m = float(self._end_m(action, np.array([action.way_m]))[0])
        return RigStanding(end_m, action.ring_m, self._home_m(action, at))

    def home_s(self, action: SweepAction, way_m: Float64Array, at: RigStanding) -> Float64Array:
        """Return seconds from the end of so much of an action to where the next trial begins, shape (n,)."""
        home_m = self._home_m(action, at)
        return np.array([self._over_s(end_m, home_m) for end_m in self._end_m(action, way_m).tolist()])

    def seconds(self, actions: Sequence[SweepAction], at: RigStanding) -> Float64Array:
        """Return what each action, swept to its end, adds to a trial that ends after it, shape (a,).

        The way home is part of it, less that from where the rig is now: a sweep back saves it.
        """
        saved_s = 0.0
        if at.stage_m is not None and at.home_m is not None:
            saved_s = self._over_s(at.stage_m, at.home_m)
        found = []
        for action in actions:
            way = np.array([action.way_m])
            swept_s = self.sweep_s(action, way)[0] + self.home_s(action, way, at)[0]
            found.append(self.to_s(action, at) + float(swept_s) - saved_s)
        return np.array(found)

    def _start_m(self, action: SweepAction) -> float:
        stage = replace(self.stage, sweep_speed_m_per_s=action.speed_m_per_s)
        return stage.sweep_start(action.from_m, action.to_m)

    def _home_m(self, action: SweepAction, at: RigStanding) -> float:
        return self._start_m(action) if at.home_m is None else at.home_m

    def _end_m(self, action: SweepAction, way_m: Float64Array) -> Float64Array:
        """Return where the stage comes to rest; stopped on the way, as if it went on to the lead's end."""
        run_up_m = abs(action.from_m - self._start_m(action))
        return np.asarray(action.from_m + action.sign * (way_m + run_up_m))

    def _ring_s(self, ring_m: float, at: RigStanding) -> float:
        if at.ring_m is not None:
            return float(self.ring.move_s(np.asarray(at.ring_m), np.asarray(ring_m)))
        if not self.ring.rehomes:
            return 0.0
        return (ring_m + self.ring.home_m) / self.ring.ring_m_per_s + self.ring.settle_s

    def _over_s(self, from_m: float, to_m: float) -> float:
        """Return seconds to lift, go over and lower."""
        stage = self.stage
        return 2.0 * _leg_s(stage.lift_m, stage.lift_speed_m_per_s, stage.accel_m_per_s2) + _leg_s(
            abs(to_m - from_m), stage.return_speed_m_per_s, stage.accel_m_per_s2
        )


def _leg_s(length_m: float, speed_m_s: float, accel_m_s2: float) -> float:
    return MotionProfile(0.0, length_m, speed_m_s, accel_m_s2, 0).end_ns * 1e-9
