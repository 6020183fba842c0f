"""Sessions of one policy made into the numbers of a table: accuracy, probes, seconds, calibration.

Intervals are over sessions (cluster bootstrap): trials of one session are not independent facts.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import (
    calibration_interval,
    cluster_bootstrap,
    share_interval,
    sign_flip,
)
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.units import Float64Array

_SEED = 11  # of the resamples; every table gives the same intervals for the same sessions


def depth_key(depth_m: float) -> str:
    """Return a depth as a table's key, in mm."""
    return f"{depth_m * 1e3:g}"


def accuracies(sessions: Sequence[Outcomes]) -> Float64Array:
    """Return the share of right estimates of each session, shape (s,)."""
    return np.array([one.correct.mean() for one in sessions])


def paired(first: Sequence[Outcomes], second: Sequence[Outcomes]) -> dict[str, Any]:
    """Return the difference of two ways' accuracies, session by session, and the ratio of their seconds.

    Returns:
        ``difference`` of the first from the second with ``difference_ci`` and ``p``, ``times_fewer_seconds``
        that the first takes with ``times_ci``.
    """
    rng = np.random.default_rng(24)
    difference = accuracies(first) - accuracies(second)
    interval = cluster_bootstrap(difference, rng, within=(-1.0, 1.0))
    seconds = [np.array([one.seconds.mean() for one in runs]) for runs in (first, second)]
    ratio = cluster_bootstrap(seconds[1] / seconds[0], rng, within=(0.0, np.inf))
    return {
        "difference": interval.value,
        "difference_ci": [interval.low, interval.high],
        "p": sign_flip(difference, rng),
        "times_fewer_seconds": ratio.value,
        "times_ci": [ratio.low, ratio.high],
    }


def summarise(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return one policy's line.

    Returns:
        ``accuracy`` with ``ci`` as [low, high], ``per_depth`` and ``per_depth_ci`` by depth in mm, mean
        ``probes``, ``moves`` and ``seconds`` a trial, ``ece`` (expected calibration error over all trials)
        with ``ece_ci``, ``overconfidence``, ``undecided`` share, the number of ``sessions`` and each one's
        accuracy.
    """
    rng = np.random.default_rng(_SEED)
    overall = share_interval([one.correct for one in sessions], rng)
    depth = {
        depth_key(depth_m): share_interval([one.correct[one.depth == c] for one in sessions], rng)
        for c, depth_m in enumerate(depths_m)
    }
    stated = calibration(
        np.clip(np.concatenate([one.confidence for one in sessions]), 0.0, 1.0),
        np.concatenate([one.correct for one in sessions]).tolist(),
    )
    return {
        "accuracy": overall.value,
        "ci": [overall.low, overall.high],
        "per_depth": {key: one.value for key, one in depth.items()},
        "per_depth_ci": {key: [one.low, one.high] for key, one in depth.items()},
        "probes": _mean([one.probes for one in sessions]),
        "moves": _mean([one.moves for one in sessions]),
        "seconds": _mean([one.seconds for one in sessions]),
        "ece": stated.expected_error,
        "ece_ci": list(
            calibration_interval(
                [(one.confidence, one.correct) for one in sessions], np.random.default_rng(_SEED)
            )
        ),
        "overconfidence": stated.overconfidence,
        "undecided": 1.0 - _mean([one.decided for one in sessions]),
        "sessions": len(sessions),
        "per_session": accuracies(sessions).tolist(),
    }


def _mean(values: Sequence[Any]) -> float:
    return float(np.mean(np.concatenate(values)))


def average_of(sessions: Mapping[str, Sequence[Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the line of the average over several policies, a session's average being one value."""
    return summarise(joined(sessions), depths_m)


def joined(sessions: Mapping[str, Sequence[Outcomes]]) -> list[Outcomes]:
    """Return the trials of several policies as one policy's, session by session."""
    return [_join(row) for row in zip(*sessions.values(), strict=True)]


def _join(parts: Sequence[Outcomes]) -> Outcomes:
    """Return the trials of several policies in one session as one."""
    names = Outcomes.__dataclass_fields__
    return Outcomes(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
