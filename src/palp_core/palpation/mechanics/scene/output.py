"""What a scene is asked for: peak, contrast, trace, separation of depths, and decisions between them."""

from collections.abc import Sequence

import numpy as np

from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep, sweep
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.units import Float64Array

STEP_M = 0.00025


def grid_m(scene: Scene, step_m: float = STEP_M) -> Float64Array:
    """Return even stage positions along the path, at most ``step_m`` apart, both ends included."""
    length_m = abs(scene.path.to_m - scene.path.from_m)
    count = max(int(np.ceil(length_m / step_m - 1e-9)), 8) + 1
    return np.linspace(scene.path.from_m, scene.path.to_m, count)


def peak_n_m(solved: Sweep) -> float:
    """Return the largest torque along the sweep, of the sign of the sweep."""
    return float(np.max(np.abs(solved.torque_n_m)))


def contrast_n_m(solved: Sweep) -> float:
    """Return the peak minus its local base: the line through the torque at both ends, under the peak."""
    torque, stage = np.abs(solved.torque_n_m), solved.stage_m
    at = int(np.argmax(torque))
    share = (stage[at] - stage[0]) / (stage[-1] - stage[0])
    return float(torque[at] - (torque[0] + share * (torque[-1] - torque[0])))


def _torque_n_m(solved: Sweep) -> Float64Array:
    return solved.torque_n_m


def separation_n_m(peaks_n_m: Sequence[float]) -> float:
    """Return the smallest gap between the peaks of any two depths."""
    return float(np.min(np.diff(np.sort(np.asarray(peaks_n_m, dtype=np.float64)))))


# What makes one palpation differ from the next, for ``decision``.
_RING_M = 0.0003  # half-range of the ring's error, uniform; published
_HEIGHT_M = 0.0001  # standard deviation of a mounting's height; assumed, set down by hand against a stop
_TRAINING_COUNT = 25  # palpations per depth that the normals are fitted to; published
_TRIAL_COUNT = 2000  # decisions drawn


def decisions(
    models: Sequence[ContactModel], scene: Scene, rng: np.random.Generator
) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Return which depth each palpation would be taken for, shape (rings, trials).

    Peaks scatter to first order in ring and height about the nominal ones; each depth is a normal fitted to
    its training; the largest likelihood wins. The same ``rng`` state gives the same draws whatever the
    models.
    """
    count = len(models)
    made = np.empty((len(scene.ring_m), _TRIAL_COUNT), dtype=np.int64)
    for i, ring_m in enumerate(scene.ring_m):
        response = np.array([_response(model, scene, ring_m) for model in models])

        def draw(
            of: np.ndarray[tuple[int], np.dtype[np.int64]], table: Float64Array = response
        ) -> Float64Array:
            size = of.size
            peak: Float64Array = table[of, 0] + RESOLUTION_N_M * rng.standard_normal(size)
            peak += table[of, 1] * rng.uniform(-1.0, 1.0, size)
            peak += table[of, 2] * rng.standard_normal(size)
            return peak

        training = draw(np.repeat(np.arange(count), _TRAINING_COUNT)).reshape(count, -1)
        mean, sd = training.mean(axis=1)[:, None], training.std(axis=1, ddof=1)[:, None]
        peaks = draw(np.arange(_TRIAL_COUNT) % count)
        made[i] = np.argmax(-0.5 * ((peaks - mean) / sd) ** 2 - np.log(sd), axis=0)
    return made


def _response(model: ContactModel, scene: Scene, ring_m: float) -> tuple[float, float, float]:
    """Return the peak, and by how much ring error and mounting move it."""
    stage, depth = grid_m(scene, 0.0005), scene.path.indentation_m

    def peak(ring: float, indentation: float) -> float:
        return peak_n_m(sweep(model, scene.probe, ring, indentation, stage))

    lower = max(ring_m - _RING_M, 0.0)  # a ring at the pivot has nowhere lower to go
    by_ring = (peak(ring_m + _RING_M, depth) - peak(lower, depth)) * (_RING_M / (ring_m + _RING_M - lower))
    by_height = 0.5 * (peak(ring_m, depth + _HEIGHT_M) - peak(ring_m, depth - _HEIGHT_M))
    return peak(ring_m, depth), by_ring, by_height


def outputs(models: Sequence[ContactModel], scene: Scene) -> Float64Array:
    """Return the scene's output, one entry per ring; of ``trace`` the torques, shape (rings, positions)."""
    stage, depth_m = grid_m(scene), scene.path.indentation_m
    of = {"contrast": contrast_n_m, "trace": _torque_n_m}.get(scene.tolerance.output, peak_n_m)
    found = np.array(
        [
            [of(sweep(model, scene.probe, ring_m, depth_m, stage)) for ring_m in scene.ring_m]
            for model in models
        ]
    )
    if scene.tolerance.output != "separation":
        return np.asarray(found[0])
    return np.array([separation_n_m(column) for column in found.T])


def answer(models: Sequence[ContactModel], scene: Scene, seed: int = 1) -> Float64Array:
    """Return what a scene is asked for: its output by ring, or its decisions, shape (rings, trials)."""
    if scene.tolerance.output == "decision":
        return decisions(models, scene, np.random.default_rng(seed)).astype(np.float64)
    return outputs(models, scene)


def answer_error(given: Float64Array, true: Float64Array, scene: Scene) -> float:
    """Return the largest relative error of the scene's output over its rings, or the share of decisions.

    A trace's is its largest error anywhere, over its peak.
    """
    if scene.tolerance.output == "decision":
        return float(np.mean(given != true))
    size = np.abs(true).max(axis=1, keepdims=True) if scene.tolerance.output == "trace" else np.abs(true)
    scale = np.where(size == 0.0, 1.0, size)
    return float(np.max(np.where(given == true, 0.0, np.abs(given - true) / scale)))
