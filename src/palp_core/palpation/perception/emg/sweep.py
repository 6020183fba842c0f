"""How much the unpublished settings of the EMG chain decide: bursts and lambda_2 over their ranges."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse, second_eigenvalue
from palp_core.units import Float64Array


@dataclass(frozen=True)
class SweepRow:
    """What one combination gives over all trials.

    Attributes:
        window_s: RMS window.
        prominence: Least prominence of a burst, dimensionless.
        distance_s: Least time between bursts.
        burst_count: Bursts.
        transition_count: Transitions between consecutive bursts of a trial.
        lambda_2: As of :func:`second_eigenvalue`; NaN without a transition.
    """

    window_s: float
    prominence: float
    distance_s: float
    burst_count: int
    transition_count: int
    lambda_2: float


def sweep(
    trials: Sequence[tuple[Float64Array, Float64Array]],
    settings: EmgSettings,
    *,
    windows_s: Sequence[float] = (0.02, 0.05, 0.1, 0.15, 0.2),
    prominences: Sequence[float] = (0.025, 0.05, 0.1),
    distances_s: Sequence[float] = (0.1, 0.2, 0.4),
) -> list[SweepRow]:
    """Return a row per combination, transitions pooled over trials, never across them.

    Args:
        trials: Raw EMG of trial and MVC, each of shape (muscles, n), as of :func:`analyse`.
        settings: Everything else.
        windows_s: RMS windows, 0.02 to 0.2.
        prominences: Prominences.
        distances_s: Distances.
    """
    rows = []
    for window_s, prominence, distance_s in product(windows_s, prominences, distances_s):
        these = replace(settings, window_s=window_s, prominence=prominence, distance_s=distance_s)
        runs = [run for samples, mvc in trials for run in analyse(samples, mvc, these).runs]
        rows.append(
            SweepRow(
                window_s=window_s,
                prominence=prominence,
                distance_s=distance_s,
                burst_count=sum(map(len, runs)),
                transition_count=sum(len(run) - 1 for run in runs),
                lambda_2=second_eigenvalue(runs),
            )
        )
    return rows
