"""Accuracy with an interval, and whether stated confidence was deserved.

An interval from the trials of one training and one set of phantoms speaks for that session only: such trials
are not independent of each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

_Z_95 = 1.959963984540054
"""The normal quantile 0.975 by ``scipy.special.ndtri``, which takes as long to load as a report."""


@dataclass(frozen=True)
class Interval:
    """An estimate with its interval; an end that the data do not set is infinite."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Proportion:
    """A share with its interval."""

    value: float  # Successes over trials
    low: float  # Lower bound
    high: float  # Upper bound
    success_count: int  # Successes
    trial_count: int  # Trials


def wilson(success_count: int, trial_count: int) -> Proportion:
    """Return a share with Wilson's score interval of 95 % (Wilson, 1927).

    It stays within 0 to 1 and is not empty at 0 or n of n. It is that of ``scipy.stats.binomtest`` to the
    last bit.

    Raises:
        PerceptionError: No trial, or more successes than trials.
    """
    if trial_count < 1 or not 0 <= success_count <= trial_count:
        raise PerceptionError(f"{success_count} of {trial_count} is not a proportion")
    share, z = success_count / trial_count, _Z_95
    whole = 2 * (trial_count + z**2)
    middle = (2 * trial_count * share + z**2) / whole
    half = z / whole * np.sqrt(4 * trial_count * share * (1 - share) + z**2)
    low = 0.0 if success_count == 0 else float(middle - half)
    high = 1.0 if success_count == trial_count else float(middle + half)
    return Proportion(share, low, high, success_count, trial_count)


def confusion(actual: Sequence[int], estimated: Sequence[int], class_count: int) -> NDArray[np.int64]:
    """Return counts [actual, estimated], shape (m, m)."""
    truth, guess = np.asarray(actual, dtype=np.int64), np.asarray(estimated, dtype=np.int64)
    if truth.shape != guess.shape:
        raise PerceptionError(f"{truth.size} actual classes, {guess.size} estimates")
    both = np.concatenate([truth, guess])
    if both.size and not 0 <= both.min() <= both.max() < class_count:
        raise PerceptionError(f"a class lies outside 0 to {class_count - 1}")
    table = np.zeros((class_count, class_count), dtype=np.int64)
    np.add.at(table, (truth, guess), 1)
    return table


@dataclass(frozen=True)
class ReliabilityBin:
    """Estimates of similar confidence."""

    low: float  # Lower edge of the bin
    high: float  # Upper edge
    mean_confidence: float  # Mean stated probability
    accuracy: Proportion  # Share that was right, with its interval


@dataclass(frozen=True)
class ConfidenceCalibration:
    """Stated confidence against actual accuracy."""

    expected_error: float  # Expected calibration error: |accuracy - confidence| averaged over trials, 0 to 1
    overconfidence: float  # Mean confidence minus accuracy; positive is over-confident
    bins: tuple[ReliabilityBin, ...]  # The bins that hold a trial


def reliability_bins(stated: Float64Array, bin_count: int) -> NDArray[np.int64]:
    """Return the bin of each probability, equal bins over 0 to 1, upper edges inclusive, shape (n,)."""
    edges = np.linspace(0.0, 1.0, bin_count + 1)
    return np.clip(np.searchsorted(edges, stated, side="left") - 1, 0, bin_count - 1)


def calibration(
    confidence: Float64Array, correct: Sequence[bool], *, bin_count: int = 10
) -> ConfidenceCalibration:
    """Compare the probability of the chosen class with how often it was right."""
    stated, right = np.asarray(confidence, dtype=np.float64), np.asarray(correct, dtype=bool)
    if stated.size == 0 or stated.shape != right.shape or not ((stated >= 0.0) & (stated <= 1.0)).all():
        raise PerceptionError(
            "calibration needs one probability and one outcome per trial, and at least one trial"
        )
    edges, which = np.linspace(0.0, 1.0, bin_count + 1), reliability_bins(stated, bin_count)
    bins = tuple(
        ReliabilityBin(
            float(edges[b]),
            float(edges[b + 1]),
            float(stated[which == b].mean()),
            wilson(int(right[which == b].sum()), int((which == b).sum())),
        )
        for b in np.unique(which)
    )
    gaps = [abs(b.accuracy.value - b.mean_confidence) * b.accuracy.trial_count for b in bins]
    return ConfidenceCalibration(float(sum(gaps) / stated.size), float(stated.mean() - right.mean()), bins)
