"""How much the unpublished settings of the EMG chain decide: bursts, peaks and lambda_2 over their ranges."""

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
        on_share: Upper threshold above rest, of MVC; the lower one is half of it.
        valley_share: Share of a peak below which it ends.
        burst_count: Bursts.
        peak_count: Peaks within them.
        transition_count: Transitions between consecutive peaks of a trial.
        lambda_2: As of :func:`second_eigenvalue`; NaN without a transition.
    """

    window_s: float
    on_share: float
    valley_share: float
    burst_count: int
    peak_count: int
    transition_count: int
    lambda_2: float


def sweep(
    trials: Sequence[tuple[Float64Array, Float64Array]],
    settings: EmgSettings,
    *,
    windows_s: Sequence[float] = (0.02, 0.05, 0.1, 0.15, 0.2),
    on_shares: Sequence[float] = (0.025, 0.05, 0.1),
    valley_shares: Sequence[float] = (0.5, 0.6, 0.7),
) -> list[SweepRow]:
    """Return a row per combination, transitions pooled over trials, never across them.

    Args:
        trials: Raw EMG of trial and MVC, each of shape (muscles, n), as of :func:`analyse`.
        settings: Everything else.
        windows_s: RMS windows, 0.02 to 0.2.
        on_shares: Upper thresholds.
        valley_shares: Shares of a peak below which it ends.
    """
    rows = []
    for window_s, on_share, valley_share in product(windows_s, on_shares, valley_shares):
        bursts = replace(
            settings.bursts, on_share=on_share, off_share=on_share / 2.0, valley_share=valley_share
        )
        these = replace(settings, window_s=window_s, bursts=bursts)
        found = [analyse(samples, mvc, these) for samples, mvc in trials]
        runs = [run for one in found for run in one.runs]
        rows.append(
            SweepRow(
                window_s=window_s,
                on_share=on_share,
                valley_share=valley_share,
                burst_count=sum(len(one.bursts) for one in found),
                peak_count=sum(map(len, runs)),
                transition_count=sum(len(run) - 1 for run in runs),
                lambda_2=second_eigenvalue(runs),
            )
        )
    return rows
