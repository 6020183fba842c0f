"""Trials by their whole traces, as a session is held against its training by them.

Each trial's torques are projected on what the offsets of the mechanics add to them, with the weights by which
its belief tells those offsets; how badly they fit is one projection more. Training's mountings, each less the
mean of its class, are projected with the same weights. So trials and mountings are of one law where nothing
but the mounting differs, whatever the filter takes for granted of spreads: that only chooses the weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.palpation.perception.belief.session_check import MISFIT, Projected
from palp_core.palpation.perception.trace.belief import TraceBelief, offset_weights
from palp_core.palpation.perception.trace.model import SweepOf, TraceModel
from palp_core.palpation.perception.trace.training import TrainedTraces
from palp_core.units import Float64Array

_FELT = 0.2  # of its spread, for an offset to be told by the torque


def _told_apart(model: TraceModel) -> NDArray[np.int64]:
    """Return by which offsets trials are held against training: the mechanics' that stay for a trial."""
    bent = [name.endswith(" squared") for name in model.names]
    stay = [stays == "trial" for stays in model.stays]
    return np.flatnonzero(np.array(stay) & ~np.array(bent, dtype=bool))


def projected(model: TraceModel, trained: TrainedTraces, belief: TraceBelief, of: int) -> Projected:
    """Return trials as they are held against training.

    In units of the spread that the model states for an offset; 0 for one that the torque does not tell.

    Args:
        model: What sweeps look like.
        trained: Training.
        belief: What the trials felt.
        of: The class that they are all taken for.
    """
    component, sweeps = _middle(model, of), belief.sweeps
    rows, weights = offset_weights(model, sweeps, component)
    which = _told_apart(model)
    weights, sd = weights[:, which], model.offset_sd[which]
    told = np.sqrt((weights**2).sum(axis=0))
    unit = np.where(told > _FELT * sd, weights / np.where(told > 0.0, told, 1.0), 0.0)
    own = np.flatnonzero(trained.between_class == of)
    lands = np.array([stays == "landing" for stays in model.stays])
    landed = np.concatenate([model.slope[component, one.setting, : one.bins] for one in sweeps])
    felt, landing = belief.innovation[:, component], _whitened(rows, (landed * model.offset_sd)[:, lands].T)
    taught = np.zeros((0, len(which) + 1))
    if len(own):
        mounted, alone = _as_mounted(trained, sweeps, own)
        misfit = _misfit(_whitened(rows, alone.reshape(-1, alone.shape[-1])))
        misfit = misfit.reshape(alone.shape[:2]).mean(axis=1)
        taught = np.column_stack([_whitened(rows, mounted) @ unit, misfit])
    names = *(model.names[i] for i in which), MISFIT
    return Projected(
        names,
        of,
        np.column_stack([felt @ unit, _misfit(felt)]),
        np.append(np.sqrt(((landing @ unit) ** 2).sum(axis=0)), 0.0),
        taught,
        trained.mountings,
        float(np.mean(trained.mountings / (trained.mountings + 1.0))),  # a trial's, less the mean's part
    )


def _whitened(rows: Float64Array, torque_n_m: Float64Array) -> Float64Array:
    """Return the innovations of torques less their mean, shape (n, past)."""
    return np.asarray(scipy.linalg.solve_triangular(rows, torque_n_m.T, lower=True).T)


def _middle(model: TraceModel, of: int) -> int:
    """Return the component of a class in the middle of its grid, if there is one: that of its mean."""
    own = np.flatnonzero(model.class_of == of)
    return int(own[len(own) // 2])


def _misfit(innovation: Float64Array) -> Float64Array:
    return np.asarray(np.log(np.maximum((innovation**2).mean(axis=-1), 1e-12)))


def _as_mounted(
    trained: TrainedTraces, sweeps: Sequence[SweepOf], own: NDArray[np.int64]
) -> tuple[Float64Array, Float64Array]:
    """Return mountings of a class as if each had been swept like a trial, less the mean of them all.

    Returns:
        Their mean torques, shape (mountings, past); and the torques of single sweeps, shape (mountings,
        repeats, past), of mountings that are as far off as one that has no part in the mean.
    """
    mounted = np.concatenate([trained.between[own, one.setting, : one.bins] for one in sweeps], axis=-1)
    alone = [
        np.roll(trained.repeats[own, one.setting, :, : one.bins], number, axis=1)
        for number, one in enumerate(sweeps)
    ]
    further = np.sqrt((len(own) + 1.0) / (len(own) - 1.0))
    return mounted, np.concatenate(alone, axis=-1) + further * mounted[:, None]
