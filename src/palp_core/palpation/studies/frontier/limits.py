"""What no way of reading the trace can pass: Wald's bound and Fano's, along a sweep."""

from __future__ import annotations

import numpy as np
import scipy

from palp_core.palpation.perception.trace.model import SweepOf, TraceModel
from palp_core.palpation.studies.plan import Protocol
from palp_core.units import Float64Array


def divergences(model: TraceModel, setting: int) -> Float64Array:
    """Return the Kullback-Leibler divergence of each class from each after so many bins, nats, (m, m, b).

    Of the torques of a first sweep, as the model has them.
    """
    factor = model.factor((), SweepOf(setting, 0, model.bin_count))
    m, bins = factor.mean.shape
    found = np.zeros((m, m, bins))
    for i in range(m):
        for j in range(m):
            if i == j:
                continue
            across = scipy.linalg.solve_triangular(factor.rows[j], factor.rows[i], lower=True)
            apart = scipy.linalg.solve_triangular(factor.rows[j], factor.mean[i] - factor.mean[j], lower=True)
            spread = np.cumsum((across**2).sum(axis=1))  # trace of the leading blocks: rows stand alone
            volume = 2.0 * np.cumsum(factor.log_diagonal[j] - factor.log_diagonal[i])
            found[i, j] = 0.5 * (spread - np.arange(1, bins + 1) + volume + np.cumsum(apart**2))
    return found


def most_accurate(model: TraceModel, setting: int, protocol: Protocol, bin_m: float) -> Float64Array:
    """Return seconds, Fano's bound and Wald's on the accuracy after so many bins, shape (b, 3).

    Fano: information is at most -sum_i w_i log sum_j w_j exp(-KL_ij) (Kolchinsky and Tracey, 2017). Wald: two
    classes that are hardest to distinguish need the binary divergence of the error from its complement.
    """
    kl = divergences(model, setting)
    m, bins = kl.shape[0], kl.shape[2]
    rows = []
    for b in range(bins):
        bits = float(-np.mean(np.log2(np.mean(np.exp(-kl[:, :, b]), axis=1))))
        least = min(kl[i, j, b] for i in range(m) for j in range(m) if i != j)
        way = np.array([(b + 1) * bin_m])
        seconds = float(protocol.sweep_s(way)[0] + protocol.back_s(way)[0])
        rows.append((seconds, fano_accuracy(bits, m), wald_accuracy(float(least))))
    return np.array(rows)


def fano_accuracy(information_bits: float, class_count: int) -> float:
    """Return the largest share of right answers that an information permits, from a flat belief.

    Fano's inequality: H(d) - I <= h(e) + e log2(m - 1), solved for the error e.
    """
    left = np.log2(class_count) - max(information_bits, 0.0)
    if left <= 0.0:
        return 1.0

    def slack(error: float) -> float:
        spread = -error * np.log2(error) - (1.0 - error) * np.log2(1.0 - error)
        return float(spread + error * np.log2(class_count - 1.0) - left)

    worst = 1.0 - 1.0 / class_count
    if slack(worst) <= 0.0:
        return 1.0 - worst
    return 1.0 - float(scipy.optimize.brentq(slack, 1e-15, worst))


def wald_accuracy(nats: float) -> float:
    """Return the accuracy at which the divergence between error and success is so large."""
    if nats > 30.0:
        return 1.0
    return float(
        scipy.optimize.brentq(
            lambda a: (2.0 * a - 1.0) * np.log(a / (1.0 - a)) - nats, 0.5, 1.0 - 1e-15, xtol=1e-15
        )
    )
