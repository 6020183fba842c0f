"""What a sweep is expected to tell about the class, before it is made."""

from __future__ import annotations

import numpy as np
import scipy

from palp_core.palpation.perception.trace.belief import TraceBelief, begin_sweep
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.units import Float64Array


def expected_bits(
    model: TraceModel, belief: TraceBelief, setting: int, *, landed: bool, bins: int | None = None
) -> Float64Array:
    """Return a lower bound on the bits that a sweep tells about the class, shape (n,).

    The entropy of a mixture is not had in closed form; with the Bhattacharyya distances D between its parts
    it is at least -sum_i w_i log sum_j w_j exp(-D_ij) above their own (Kolchinsky and Tracey, Entropy 19,
    2017).
    Parts of one class count as one.

    Args:
        model: What sweeps look like.
        belief: What trials know.
        setting: Of the sweep.
        landed: Whether the ring is moved, or re-homed, for it.
        bins: How many of the setting's bins are swept, from the first on; None: all.
    """
    read = slice(model.bin_count if bins is None else bins)
    last = begin_sweep(belief, setting, landed=landed).sweeps[-1]
    factor = model.factor(belief.sweeps, last._replace(bins=model.bin_count))
    past = belief.innovation.shape[2]
    mean = factor.mean[:, read] + np.einsum("cbp,ncp->ncb", factor.rows[:, read, :past], belief.innovation)
    own = factor.rows[:, read, past:]
    spread = own @ np.swapaxes(own, 1, 2)
    log_volume = factor.log_diagonal[:, read].sum(axis=1)
    joint = belief.log_density + model.log_weight
    weight = np.exp(joint - scipy.special.logsumexp(joint, axis=1, keepdims=True))
    parts = len(model.class_of)
    alike = np.ones((len(weight), parts, parts))
    for i in range(parts):
        for j in range(i):
            if model.class_of[i] == model.class_of[j]:
                continue
            lower = np.linalg.cholesky(0.5 * (spread[i] + spread[j]))
            apart = scipy.linalg.solve_triangular(lower, (mean[:, i] - mean[:, j]).T, lower=True)
            volume = np.log(np.diag(lower)).sum() - 0.5 * (log_volume[i] + log_volume[j])
            alike[:, i, j] = alike[:, j, i] = np.exp(-0.125 * (apart**2).sum(axis=0) - volume)
    met = np.einsum("nij,nj->ni", alike, weight)
    return np.asarray(-(weight * np.log2(met)).sum(axis=1))
