"""Gel modulus and friction by least squares, from recorded sweeps over phantoms of known depth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from palp_core.errors import PalpError
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.statistics.statistics import Interval
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from palp_core.palpation.session.repeatability import sample_noise
from palp_core.units import Float64Array

_EDGE = 50  # samples on either side of a cubic's middle (Savitzky and Golay, 1964)
_NOISE_GAIN = 0.15  # the root sum of its squared weights there
_POINT_STEP_M = 0.002
_LEAST_RING_M = 1e-3  # with next to no spring torque, its sign is that of the ring's error
_RING_SD_M = 0.3e-3 / 3.0**0.5  # about its target: the data sheet's +-0.3 mm, all alike
_HEIGHT_SD_M = 1e-4  # of a phantom over mountings (assumed)
_NUMERICS_N_M = 2e-6  # error of the tables' interpolation (assumed)
_LOW, _HIGH = np.array([np.log(1e3), 0.01]), np.array([np.log(2e5), 1.5])  # ln(modulus in Pa), friction


@dataclass(frozen=True)
class GelFit:
    """What recorded sweeps show of a gel, with 95 % intervals."""

    modulus_pa: Interval
    friction: Interval
    misfit: float  # chi^2 over its degrees of freedom; above 1, the intervals are wider by its root


def fit_gel(sessions: Sequence[RecordedSweeps], scene: Scene) -> GelFit:
    """Fit modulus and friction to the sweeps of training and of ``plan:=repeatability``.

    Each mounting's height is fitted, too; errors of ring and contact model (its bound) are in the covariance.

    Args:
        sessions: Recorded sweeps.
        scene: What is not fitted, the stage's path as it ran included; and where the search starts.

    Raises:
        PalpError: No sweep is of a known phantom, or sweeps of a cell differ in length or are short.
        MethodError: No contact model is good enough over one of the depths.
    """
    cells = _mean_sweeps(sessions, scene)
    choices = {depth_m: choose_rung(scene.with_bead(depth_m)) for depth_m in {c.depth_m for c in cells}}

    def torque(x: Float64Array, ring_m: float = 0.0) -> Float64Array:
        probe = replace(scene.probe, friction=float(x[1]))
        curves = []
        for cell in cells:
            phantom = replace(scene.with_bead(cell.depth_m).phantom, modulus_pa=float(np.exp(x[0])))
            model = rung_model(choices[cell.depth_m].rung, phantom, probe.tip_radius_m)
            indentation_m = float(np.exp(x[2 + cell.mounting]))
            table = solve(model, probe, cell.ring_m + ring_m, indentation_m, *cell.stage_m[[0, -1]].tolist())
            curves.append(table.torque_n_m(cell.stage_m))
        return np.concatenate(curves)

    def residuals(x: Float64Array, root: Float64Array) -> Float64Array:
        heights = (np.exp(x[2:]) - scene.path.indentation_m) / _HEIGHT_SD_M
        return np.concatenate([solve_triangular(root, torque(x) - measured, lower=True), heights])

    def each(values: Sequence[float]) -> Float64Array:
        return np.repeat(np.array(values, dtype=float), [cell.stage_m.size for cell in cells])

    measured = np.concatenate([cell.torque_n_m for cell in cells])
    model_bounds = each([choices[cell.depth_m].bound or scene.tolerance.relative for cell in cells])
    number, depth_m = each(range(len(cells))), each([cell.depth_m for cell in cells])
    gel = np.clip([np.log(scene.phantom.modulus_pa), scene.probe.friction], _LOW, _HIGH)
    x = np.append(gel, [np.log(scene.path.indentation_m)] * (1 + max(cell.mounting for cell in cells)))
    bounds = (np.append(_LOW, x[2:] - 1.0), np.append(_HIGH, x[2:] + 1.0))
    steps = np.full(x.size, 1e-3)  # longer than the tables' interpolation is off
    for _ in range(2):  # the first round's covariance is of the scene as given
        given = torque(x)
        ring = torque(x, _RING_SD_M) - given
        model = model_bounds / 3.0**0.5 * given  # half a flat law's width
        covariance = np.diag(each([cell.sd_n_m for cell in cells]) ** 2)
        covariance += np.equal.outer(number, number) * np.outer(ring, ring)
        covariance += np.equal.outer(depth_m, depth_m) * np.outer(model, model)
        root = cholesky(covariance, lower=True)
        found = least_squares(residuals, x, bounds=bounds, diff_step=steps, xtol=1e-6, args=(root,))
        x = found.x
    misfit = 2.0 * float(found.cost) / (measured.size - 2)
    slopes = np.asarray(found.jac, dtype=np.float64)
    reach = 1.96 * np.sqrt(max(misfit, 1.0) * np.diag(np.linalg.inv(slopes.T @ slopes))[:2])
    ends = np.array([x[:2], x[:2] - reach, x[:2] + reach])
    return GelFit(Interval(*np.exp(ends[:, 0]).tolist()), Interval(*ends[:, 1].tolist()), misfit)


@dataclass(frozen=True, eq=False)
class _Cell:
    """The mean sweep of one mounting at one ring position, up to its peak: after it the tip may snap off."""

    mounting: int
    depth_m: float
    ring_m: float
    stage_m: Float64Array
    torque_n_m: Float64Array
    sd_n_m: float


def _mean_sweeps(sessions: Sequence[RecordedSweeps], scene: Scene) -> list[_Cell]:
    grouped: dict[tuple[int, int, float, float], list[RecordedSweep]] = {}
    for number, session in enumerate(sessions):
        for sweep in session.sweeps:
            if sweep.phase != "estimation" and sweep.depth_m is not None and sweep.ring_m >= _LEAST_RING_M:
                key = (number, sweep.remount, sweep.depth_m, sweep.ring_m)
                grouped.setdefault(key, []).append(sweep)
    sweeps = [sweep for group in grouped.values() for sweep in group]
    if not sweeps:
        places = ", ".join(str(session.path) for session in sessions)
        raise PalpError(f"{places}: no sweep is of a known phantom; give a session with training")
    noise_n_m = float(np.hypot(sample_noise(sweeps).value, RESOLUTION_N_M / 12.0**0.5))
    mountings = sorted({key[:2] for key in grouped})
    return [_mean(mountings.index(key[:2]), group, scene, noise_n_m) for key, group in grouped.items()]


def _mean(mounting: int, sweeps: Sequence[RecordedSweep], scene: Scene, noise_n_m: float) -> _Cell:
    first = sweeps[0]
    if len({(s.torque_n_m.size, s.rate_hz) for s in sweeps}) > 1 or first.torque_n_m.size < 8 * _EDGE:
        raise PalpError(f"ring {first.ring_m:g} m: sweeps differ in length or are short; leave them out")
    mean = savgol_filter(np.mean([sweep.torque_n_m for sweep in sweeps], axis=0), 2 * _EDGE + 1, 3)
    last = _EDGE + int(np.argmax(mean[_EDGE:-_EDGE])) if first.depth_m else mean.size - _EDGE
    advance_m = np.copysign(scene.path.speed_m_s, scene.path.to_m - scene.path.from_m) / first.rate_hz
    points = np.arange(_EDGE, last, max(1, round(_POINT_STEP_M / abs(advance_m))))
    sd_n_m = float(np.hypot(_NOISE_GAIN * noise_n_m / len(sweeps) ** 0.5, _NUMERICS_N_M))
    stage_m = scene.path.from_m + points * advance_m
    return _Cell(mounting, first.depth_m or 0.0, first.ring_m, stage_m, mean[points], sd_n_m)
