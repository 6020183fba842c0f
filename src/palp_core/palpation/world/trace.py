"""The true torque along one sweep of a world: what a simulated or emulated phantom answers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.world.drag import Dragged, drag, joints_of
from palp_core.palpation.world.model import WorldModel
from palp_core.palpation.world.stick_slip import StickSlip, stick_slip, swamped
from palp_core.palpation.world.texture import texture, texture_map
from palp_core.palpation.world.touch import Touch
from palp_core.units import Float64Array

_NODE_M = 0.0005


@dataclass(frozen=True, eq=False)
class WorldTrace:
    """Torque, forces and angle of one sweep at any position of it; beyond its ends they stay as they are."""

    solved: Sweep  # the sweep at its nodes, with what it met in guards; without texture and stick-slip
    run_in_m: float  # way of the stage until the tip slid; 0 without a run-in
    hertz: float  # largest frequency of its stick-slip; 0 without
    _world: WorldModel
    _luck: Float64Array
    _phase: float
    _speed_m_s: float
    _cycles: StickSlip
    _sliding: scipy.interpolate.PchipInterpolator
    _sticking: scipy.interpolate.PchipInterpolator

    @property
    def forward(self) -> bool:
        """Whether the stage goes towards +Y."""
        return bool(self.solved.stage_m[-1] > self.solved.stage_m[0])

    def torque_n_m(self, stage_m: Float64Array) -> Float64Array:
        """Return the sensor's true torque, of the shape of ``stage_m``, (n,)."""
        columns = self._columns(stage_m)
        torque = columns[:, 0]
        if self._world.texture_sd_n_m > 0.0:
            surface = texture_map(self._world, columns[:, 3])
            torque = torque + texture(self._world, self._luck[None], surface, forward=self.forward)[0]
        if self.hertz > 0.0:
            nodes, phase = self.solved.stage_m, np.array([self._phase])
            torque = torque + self._cycles.added(nodes, self._within(stage_m), self._speed_m_s, phase)[0]
        return np.asarray(torque)

    def again(self, phase: float) -> WorldTrace:
        """Return another sweep just like it, whose stick-slip begins at another share of its cycle."""
        return replace(self, _phase=phase)

    def normal_n(self, stage_m: Float64Array) -> Float64Array:
        """Return the normal force, of the shape of ``stage_m``."""
        return np.asarray(self._columns(stage_m)[:, 1])

    def lateral_n(self, stage_m: Float64Array) -> Float64Array:
        """Return the elastic drag, of the shape of ``stage_m``."""
        return np.asarray(self._columns(stage_m)[:, 2])

    def _within(self, stage_m: Float64Array) -> Float64Array:
        ends = self.solved.stage_m[[0, -1]]
        return np.clip(stage_m, ends.min(), ends.max())

    def _columns(self, stage_m: Float64Array) -> Float64Array:
        at_m = self._within(np.asarray(stage_m, dtype=np.float64))
        stuck = np.abs(at_m - self.solved.stage_m[0]) < self.run_in_m
        return np.where(stuck[:, None], self._sticking(at_m), self._sliding(at_m))


def trace(
    touch: Touch,
    world: WorldModel,
    row: Float64Array,
    luck: Float64Array,
    ring_m: float,
    indentation_m: float,
    from_m: float,
    to_m: float,
    *,
    speed_m_s: float = 0.02,
) -> WorldTrace:
    """Return the true torque of one sweep, of latents (7,) over a track (2, places); see :meth:`.again`."""
    count = math.ceil(abs(to_m - from_m) / _NODE_M - 1e-9) + 1
    if count < 5:
        raise OutOfRange("to_m", f"a sweep of {abs(to_m - from_m):g} m is too short; sweep 2 mm or more")
    stage_m = np.linspace(from_m, to_m, count)
    rows, rings_m = row[None], np.array([ring_m])
    run_in = world.run_in > 0.0
    found = drag(touch, rows, rings_m, indentation_m, stage_m, run_in=run_in)
    joints = joints_of(touch, rows, rings_m, indentation_m, 1.0 if to_m > from_m else -1.0)
    cycles = stick_slip(joints, found, world.static_friction_excess, speed_m_s)
    note = swamped(found, cycles)
    return WorldTrace(
        solved=_solved(found, (note,) if note else ()),
        run_in_m=float(found.loose_m[0]),
        hertz=float(cycles.hertz.max()),
        _world=world,
        _luck=luck,
        _phase=0.0,
        _speed_m_s=speed_m_s,
        _cycles=cycles,
        _sliding=_curves(found, found.sliding_n_m),
        _sticking=_curves(found, found.sticking_n_m),
    )


def _curves(found: Dragged, torque_n_m: Float64Array) -> scipy.interpolate.PchipInterpolator:
    """Return torque, normal force, drag and place of the ball over rising stage positions."""
    columns = np.stack([torque_n_m[0], found.normal_n[0], found.lateral_n[0], found.tip_m[0]], axis=-1)
    order = slice(None) if found.stage_m[-1] > found.stage_m[0] else slice(None, None, -1)
    return scipy.interpolate.PchipInterpolator(found.stage_m[order], columns[order])


def _solved(found: Dragged, words: tuple[str, ...]) -> Sweep:
    """Return a sweep side by side with none as the sweep that it is."""
    lifted = found.normal_n[0] <= 0.0
    return Sweep(
        stage_m=found.stage_m,
        angle_rad=found.angle_rad[0],
        torque_n_m=found.torque_n_m[0],
        normal_n=found.normal_n[0],
        lateral_n=found.lateral_n[0],
        offset_m=found.tip_m[0],
        indentation_m=found.depth_m[0],
        lifted=lifted,
        root_count=np.ones(lifted.shape, dtype=np.int64),
        snap_at=(),
        guards=(*found.guards, *words),
    )
