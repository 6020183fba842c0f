"""Bayes' rule over classes, eq. (7), carried as normalised natural logarithms.

In logarithms an outlier that is impossible under every class leaves a finite belief instead of 0/0, and a
class whose probability rounds to zero can come back.
"""

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


def flat_prior(class_count: int) -> Float64Array:
    """Return the log of the flat prior P_0 = 1/m, shape (m,)."""
    if class_count < 1:
        raise PerceptionError(f"a belief needs at least one class, not {class_count}")
    return np.full(class_count, -np.log(class_count))


def update(log_prior: Float64Array, log_likelihood: Float64Array) -> Float64Array:
    """Return the log posterior, eq. (7): prior times likelihood, normalised over the classes.

    Returns:
        Natural log of P_t, shape (m,); its exponentials sum to 1.
    """
    if log_prior.shape != log_likelihood.shape:
        raise PerceptionError(f"prior has shape {log_prior.shape}, likelihood {log_likelihood.shape}")
    joint = log_prior + log_likelihood
    top = joint.max()
    if not np.isfinite(top):
        raise PerceptionError(
            "no class is left: prior or likelihood is NaN, or excludes every class; check the reading"
        )
    joint = joint - top
    return np.asarray(joint - np.log(np.exp(joint).sum()))


def posterior(log_belief: Float64Array) -> Float64Array:
    """Return the probabilities of a log belief, shape (m,), summing to 1."""
    weights = np.exp(log_belief - log_belief.max())
    return np.asarray(weights / weights.sum())
