"""Sessions made into the numbers of a table, and tables and charts into a study's page.

Intervals are over sessions (cluster bootstrap): trials of one session are not independent facts.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.perception.statistics.resampling import (
    SessionMean,
    calibration_interval,
    cluster_bootstrap,
    share_interval,
    sign_flip,
)
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.studies.trials import Outcomes
from palp_core.units import Float64Array
from palp_core.whole_file import write_json

_SEED = 11  # of the resamples; every table gives the same intervals for the same sessions
Records = Sequence[Mapping[str, Any]]


def publish(
    out: Path, name: str, charts: Sequence[Chart], *, report: Any, tables: Mapping[str, Records], **page: Any
) -> Path:
    """Write ``NAME.json``, the tables as CSV, the charts and the page, and return the page."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{name}.json", report)
    for stem, records in tables.items():
        write_records(out / f"{stem}.csv", [_flat(one) for one in records])
    pictures = [picture(chart, out) for chart in charts]
    values = {"report": report, "pictures": pictures} | page
    return write_page(out / "index.html", f"studies/{name}.html", **values)


def _flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record without its sessions, the ends of each interval in columns of their own."""
    found: dict[str, Any] = {}
    for key, cell in record.items():
        if isinstance(cell, list) and len(cell) == 2:
            found |= {f"{key}_low": cell[0], f"{key}_high": cell[1]}
        elif key != "per_session":
            found[key] = cell
    return found


def at_most(usual: int, sessions: int) -> int:
    """Return the sessions of a case: the study's usual number, or fewer where that is asked for.

    >>> at_most(40, 0), at_most(40, 12), at_most(2, 12)
    (40, 12, 2)
    """
    if sessions < 0:
        raise PalpError(f"--sessions {sessions}: use 0 or more")
    return min(usual, sessions) if sessions else usual


def depth_key(depth_m: float) -> str:
    """Return a depth as a table's key, in mm."""
    return f"{depth_m * 1e3:g}"


def accuracies(sessions: Sequence[Outcomes]) -> Float64Array:
    """Return the share of right estimates of each session, shape (s,)."""
    return np.array([one.correct.mean() for one in sessions])


def ends(of: SessionMean) -> list[float]:
    """Return the ends of an interval."""
    return [of.low, of.high]


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
        "difference_ci": ends(interval),
        "p": sign_flip(difference, rng),
        "times_fewer_seconds": ratio.value,
        "times_ci": ends(ratio),
    }


def summarise(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return one policy's line.

    Returns:
        ``accuracy`` with ``ci`` as [low, high], ``per_depth`` by depth in mm, mean
        ``probes`` and ``seconds`` a trial, ``ece`` (expected calibration error over all trials)
        with ``ece_ci``, ``overconfidence``, ``undecided`` share, the number of ``sessions`` and each one's
        accuracy.
    """
    rng = np.random.default_rng(_SEED)
    overall = share_interval([one.correct for one in sessions], rng)
    stated = calibration(
        np.clip(np.concatenate([one.confidence for one in sessions]), 0.0, 1.0),
        np.concatenate([one.correct for one in sessions]).tolist(),
    )
    pairs = [(one.confidence, one.correct) for one in sessions]
    return {
        "accuracy": overall.value,
        "ci": ends(overall),
        "per_depth": {
            depth_key(depth_m): float(np.mean([one.correct[one.depth == c].mean() for one in sessions]))
            for c, depth_m in enumerate(depths_m)
        },
        "probes": _mean([one.probes for one in sessions]),
        "seconds": _mean([one.seconds for one in sessions]),
        "ece": stated.expected_error,
        "ece_ci": list(calibration_interval(pairs, np.random.default_rng(_SEED))),
        "overconfidence": stated.overconfidence,
        "undecided": 1.0 - _mean([one.decided for one in sessions]),
        "sessions": len(sessions),
        "per_session": accuracies(sessions).tolist(),
    }


def _mean(values: Sequence[Any]) -> float:
    return float(np.mean(np.concatenate(values)))


def some(line: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """Return some columns of a line."""
    return {key: line[key] for key in keys}


def joined(sessions: Mapping[str, Sequence[Outcomes]]) -> list[Outcomes]:
    """Return the trials of several policies as one policy's, session by session."""
    names = Outcomes.__dataclass_fields__
    return [
        Outcomes(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
        for parts in zip(*sessions.values(), strict=True)
    ]


def pareto_front(first: Sequence[float], second: Sequence[float]) -> list[int]:
    """Return the indices that nothing beats in both costs, by rising first; of equals one, NaN is no entry.

    >>> pareto_front([1.0, 2.0, 3.0], [0.5, 0.1, 0.2])
    [0, 1]
    """
    front: list[int] = []
    known = [i for i in range(len(first)) if np.isfinite(first[i]) and np.isfinite(second[i])]
    for i in sorted(known, key=lambda i: (first[i], second[i])):
        if not front or second[i] < second[front[-1]]:
            front.append(i)
    return front
