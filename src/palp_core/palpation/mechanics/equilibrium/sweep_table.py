"""A sweep solved once on a stage grid and read at any stage position, as at 1 kHz."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.joint import GridMoments
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep, sweep
from palp_core.palpation.mechanics.limits import stage_step
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array

_SNAP_PARTS = 32
_STEEP = 5e-5  # of the peak: a flank that a spline misses by more gets twice as many positions


@dataclass(frozen=True, eq=False)
class SweepTable:
    """Torque, force and angle as functions of the stage position, within the solved stretch.

    A smooth sweep is a cubic spline. One that snaps is a monotone cubic on each stretch between the jumps,
    with a straight ramp over the jump, at most 1/32 of the grid's step long.

    Attributes:
        solved: The sweep on the grid, the grid refined at jumps and on steep flanks.
    """

    solved: Sweep
    _curve: scipy.interpolate.PPoly

    @property
    def low_m(self) -> float:
        """Lowest stage position."""
        return float(min(self.solved.stage_m[0], self.solved.stage_m[-1]))

    @property
    def high_m(self) -> float:
        """Highest stage position."""
        return float(max(self.solved.stage_m[0], self.solved.stage_m[-1]))

    def torque_n_m(self, stage_m: ArrayLike) -> Float64Array:
        """Return the sensor's torque tau_f, of the shape of ``stage_m``.

        Raises:
            OutOfRange: A position lies outside the solved stretch or is not a number.
        """
        torque: Float64Array = self._torque(self._within(stage_m))
        return torque

    def normal_n(self, stage_m: ArrayLike) -> Float64Array:
        """Return the normal force; shape and errors as for :meth:`torque_n_m`."""
        return self._columns(stage_m)[..., 1]

    def angle_rad(self, stage_m: ArrayLike) -> Float64Array:
        """Return the joint angle; shape and errors as for :meth:`torque_n_m`."""
        return self._columns(stage_m)[..., 2]

    def lateral_n(self, stage_m: ArrayLike) -> Float64Array:
        """Return the elastic drag; shape and errors as for :meth:`torque_n_m`."""
        return self._columns(stage_m)[..., 3]

    @cached_property
    def _torque(self) -> scipy.interpolate.PPoly:
        """The torque's polynomials alone: what a run reads four thousand times a sweep."""
        curve = self._curve
        return scipy.interpolate.PPoly(np.ascontiguousarray(curve.c[..., 0]), curve.x)

    def _columns(self, stage_m: ArrayLike) -> Float64Array:
        values: Float64Array = self._curve(self._within(stage_m))
        return values

    def _within(self, stage_m: ArrayLike) -> Float64Array:
        """Return positions, all of them within the solved stretch."""
        positions = np.asarray(stage_m, dtype=np.float64)
        if positions.size and not (positions.min() >= self.low_m and positions.max() <= self.high_m):
            raise OutOfRange(
                "stage_m",
                f"[{positions.min():g}, {positions.max():g}] leaves the solved stretch "
                f"[{self.low_m:g}, {self.high_m:g}]; solve a longer one",
            )
        return positions


def solve(
    model: ContactModel,
    probe: Probe,
    ring_m: float,
    indentation_m: float,
    from_m: float,
    to_m: float,
    step_m: float = 0.0005,
    moments: GridMoments | None = None,
) -> SweepTable:
    """Solve a sweep once so that it can be read at any stage position.

    >>> from palp_core.palpation import Bead, Phantom, Probe, contact_model, solve
    >>> model, _ = contact_model(Phantom(bead=Bead(depth_m=0.004)), Probe().tip_radius_m)
    >>> table = solve(model, Probe(), ring_m=0.008, indentation_m=0.004, from_m=-0.03, to_m=0.05)
    >>> bool(table.torque_n_m(0.005) > table.torque_n_m(-0.03))
    True

    Args:
        model: Contact forces over the phantom.
        probe: Dimensions of the probe.
        ring_m: True position of the anchor ring.
        indentation_m: Nominal indentation of the upright probe.
        from_m: Stage position at which the sweep starts.
        to_m: Stage position at which it ends; smaller than ``from_m`` for a sweep towards -Y.
        step_m: Spacing of the grid; a jump is placed within 1/32 of it. One that would miss the peak is
            replaced by 1 mm, which ``solved.guards`` says.
        moments: What is kept for further rings at this height; None: nothing beyond this sweep.

    Raises:
        OutOfRange: The stretch is shorter than four steps.
        MechanicsError: As for :func:`.sweep`, its OutOfRange included.
    """
    if not (step_m > 0.0 and abs(to_m - from_m) >= 4.0 * step_m):
        raise OutOfRange(
            "step_m", f"{step_m:g} does not divide [{from_m:g}, {to_m:g}] in four; use a smaller step"
        )
    step_m, coarse = stage_step(step_m)
    moments = moments or GridMoments()
    count = int(np.ceil(abs(to_m - from_m) / step_m - 1e-9)) + 1
    solved = sweep(model, probe, ring_m, indentation_m, np.linspace(from_m, to_m, count), moments)
    if solved.snapped:
        parts = np.arange(1, _SNAP_PARTS) / _SNAP_PARTS
        between = [
            a + parts * (b - a)
            for a, b in ((solved.stage_m[i - 1], solved.stage_m[i]) for i in solved.snap_at)
        ]
        finer = np.unique(np.concatenate([solved.stage_m, *between]))
        solved = sweep(model, probe, ring_m, indentation_m, finer if to_m > from_m else finer[::-1], moments)
    elif (halves := _steep_halves(solved)).size:
        finer = np.unique(np.concatenate([solved.stage_m, halves]))
        solved = sweep(model, probe, ring_m, indentation_m, finer if to_m > from_m else finer[::-1], moments)
    if coarse:
        solved = replace(solved, guards=(*solved.guards, coarse))
    return SweepTable(solved, _curve(solved))


def _steep_halves(solved: Sweep) -> Float64Array:
    """Return the middles of the steps near which a spline misses the torque, judged by every second step.

    An almost snapping tip makes the torque rise within a step or two. A cubic spline's error falls with the
    fourth power of the step.
    """
    falling = solved.stage_m[0] > solved.stage_m[-1]
    stage_m, torque = (x[::-1] if falling else x for x in (solved.stage_m, solved.torque_n_m))
    last = (len(stage_m) - 1) // 2 * 2
    rough = scipy.interpolate.CubicSpline(stage_m[: last + 1 : 2], torque[: last + 1 : 2])
    missed = np.abs(rough(stage_m[1:last:2]) - torque[1:last:2]) / 16.0
    at = 1 + 2 * np.flatnonzero(missed > _STEEP * np.abs(torque).max())
    steps = np.unique(at[:, None] + np.arange(-3, 3))
    steps = steps[(steps >= 0) & (steps < len(stage_m) - 1)]
    return np.asarray(0.5 * (stage_m[steps] + stage_m[steps + 1]))


def _curve(solved: Sweep) -> scipy.interpolate.PPoly:
    """Join the stretches between jumps into one piecewise polynomial over rising stage positions."""
    columns = np.stack([solved.torque_n_m, solved.normal_n, solved.angle_rad, solved.lateral_n], axis=-1)
    falling = solved.stage_m[0] > solved.stage_m[-1]
    order = slice(None, None, -1) if falling else slice(None)
    stage_m, columns = solved.stage_m[order], columns[order]
    if not solved.snapped:
        return scipy.interpolate.CubicSpline(stage_m, columns)
    jumps = sorted(len(stage_m) - i if falling else i for i in solved.snap_at)
    pieces = []
    for low, high in itertools.pairwise([0, *jumps, len(stage_m)]):
        if low:  # the jump
            slope = (columns[low] - columns[low - 1]) / (stage_m[low] - stage_m[low - 1])
            flat = np.zeros_like(slope)
            pieces.append(np.stack([flat, flat, slope, columns[low - 1]])[:, None])
        if high - low > 1:
            pieces.append(scipy.interpolate.PchipInterpolator(stage_m[low:high], columns[low:high]).c)
    return scipy.interpolate.PPoly(np.concatenate(pieces, axis=1), stage_m)
