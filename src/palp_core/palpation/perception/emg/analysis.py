"""A recorded trial against its MVC: envelopes, co-contraction, bursts, levels, and how far to trust them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.bursts import Burst, BurstRule, EmgPeak
from palp_core.palpation.perception.emg.calibration import Calibration, calibrate, look_step
from palp_core.palpation.perception.emg.emg import EmgChain, cocontraction, normalise
from palp_core.palpation.perception.emg.levels import Levels, to_levels
from palp_core.palpation.perception.emg.quality import BoolArray, SampleQuality, bridge, lost_samples, quality
from palp_core.palpation.perception.emg.settings import (
    BURSTS,
    WINDOW_S,
    BurstSettings,
    LevelRule,
    MvcRule,
)
from palp_core.palpation.perception.strategy.markov import count_transitions, eigenvalues, transition_matrix
from palp_core.units import Float64Array

LEVEL_COUNT = 5


@dataclass(frozen=True)
class EmgSettings:
    """Settings of the analysis; rate and muscles are the paper's, the rest is assumed.

    Attributes:
        rate_hz: Sampling rate.
        low_hz: Lower edge of the band-pass.
        high_hz: Upper edge of the band-pass.
        window_s: RMS window, 0.02 to 0.2.
        bursts: What is a burst and a peak.
        mvc_rule: What the MVC comes to, as of :func:`.calibration.calibrate`; ``sum_of_maxima`` as printed.
        level_rule: Where a peak's level is read: ``plateau``, its top as a whole without the power of
            rest; ``peak``, its largest value.
        rails: Least and largest value the converter gives; None: found from the samples.
        least_mvc_ratio: Least ratio of the envelope at MVC to that at rest.
        held_s: Least stay at one value that counts as lost samples; longer for a coarse converter, whose rest
            is one value.

    Raises:
        PerceptionError: The window is outside 20 to 200 ms, or the rails are not in order.
    """

    rate_hz: float = 1500.0
    low_hz: float = 20.0
    high_hz: float = 450.0
    window_s: float = WINDOW_S
    bursts: BurstSettings = BURSTS
    mvc_rule: MvcRule = "plateau"
    level_rule: LevelRule = "plateau"
    rails: tuple[float, float] | None = None
    least_mvc_ratio: float = 5.0
    held_s: float = 0.01

    def __post_init__(self) -> None:
        if not 0.02 <= self.window_s <= 0.2:
            raise PerceptionError(f"RMS window of {1e3 * self.window_s:g} ms; choose 20 to 200 ms")
        if self.rails is not None and not self.rails[0] < self.rails[1]:
            raise PerceptionError(
                f"rails are {self.rails[0]:g} and {self.rails[1]:g}; the lower one comes first"
            )

    def chain(self, offset: float) -> EmgChain:
        """Return the chain of a muscle with this offset."""
        return EmgChain(offset, self.rate_hz, self.low_hz, self.high_hz, window_s=self.window_s)

    def level_of(self, peak: EmgPeak) -> float:
        """Return what a peak is rounded to a level from, dimensionless."""
        return peak.level if self.level_rule == "plateau" else peak.value


@dataclass(frozen=True, eq=False)
class EmgAnalysis:
    """What a trial gives; muscles in the order of the samples."""

    envelopes: Float64Array  # s_i, the samples' unit, shape (muscles, n)
    normalised: Float64Array  # s_i^N of eq. (1), dimensionless, shape (muscles, n).
    cocontraction: Float64Array  # s_CC^N of eq. (3), dimensionless, shape (n,).
    trusted: BoolArray  # Where no sample of the RMS window was lost, shape (n,)
    bursts: list[Burst]  # Contractions with a peak in a trusted part
    peaks: list[EmgPeak]  # Peaks in trusted parts
    levels: Levels  # Level of each peak
    runs: list[list[int]]  # Levels in order, split where samples were lost, so that no transition spans a gap
    maxima: tuple[float, ...]  # s_i^max, the samples' unit
    reference: float  # Denominator of eq. (3), the samples' unit.
    on: float  # Co-contraction at which a burst begins, dimensionless
    off: float  # Below which it ends
    mvc_ratio: float  # Envelope at MVC over that at rest, of the muscle where it is least
    above_mvc_count: int  # Trusted values of co-contraction above 1
    quality: tuple[SampleQuality, ...]  # Of each muscle's trial
    # What is wrong: a flag of a trial's sample quality, the same with `mvc_` before it, and `no_rest`
    # (silent, so nothing to hold the MVC against), `mvc_too_small`, `above_mvc`, `level_clamped`
    flags: tuple[str, ...]


def analyse(
    samples: Float64Array, mvc: Float64Array, settings: EmgSettings, *, rest: Float64Array | None = None
) -> EmgAnalysis:
    """Return what a trial gives.

    Args:
        samples: Raw EMG of the trial, shape (muscles, n), any unit; NaN where a sample was lost.
        mvc: Raw EMG of the MVC, shape (muscles, m), the same unit.
        settings: How.
        rest: Raw EMG at rest, shape (muscles, k). None: the quietest twentieth of trial and
            MVC is taken for it.

    Raises:
        PerceptionError: Shapes do not fit, a recording is shorter than the RMS window, has no finite sample,
            or the MVC is silent.
    """
    rate_hz = settings.rate_hz
    for name, part in (("trial", samples), ("MVC", mvc)):
        if (
            part.ndim != 2
            or len(part) != len(samples)
            or part.shape[1] <= 2 * settings.chain(0.0).window_samples
        ):
            raise PerceptionError(
                f"EMG of the {name} has shape {part.shape}; need ({len(samples)}, more than two RMS windows)"
            )
    of_trial, of_mvc = (
        tuple(quality(one, rate_hz=rate_hz, rails=settings.rails, held_s=settings.held_s) for one in part)
        for part in (samples, mvc)
    )
    effort, effort_trusted = _envelopes(mvc, settings)
    if not effort_trusted.any():
        raise PerceptionError("the MVC has no stretch without lost samples; record it again")
    maximum = effort[:, effort_trusted]
    envelopes, trusted = _envelopes(samples, settings, [one.offset for one in of_trial])
    if rest is None:
        quiet = [envelopes[:, trusted], maximum]
    else:
        found_at_rest, rest_trusted = _envelopes(rest, settings)
        quiet = [found_at_rest[:, rest_trusted]]
    skip = settings.chain(0.0).window_samples  # the first window ramps up from silence
    quiet = [part[:, skip:] for part in quiet]
    known = _calibration(maximum, quiet, settings, rest_known=rest is not None)
    rule = BurstRule.of(rate_hz, known, settings.bursts)
    value = cocontraction(envelopes, known.reference)
    found = rule.whole(value)
    peaks = [one for one in found.peaks if trusted[one.index]]
    bursts = [one for one in found.bursts if any(trusted[peak.index] for peak in one.peaks)]
    levels = to_levels(np.array([settings.level_of(one) for one in peaks]))
    resting = np.concatenate(quiet, axis=1)
    at_rest = np.quantile(resting, 0.05, axis=1) if rest is None else np.median(resting, axis=1)
    ratio = min(
        most / least if least > 0.0 else float("inf")
        for most, least in zip(known.maxima, at_rest.tolist(), strict=True)
    )
    above = int((value[trusted] > 1.0).sum())
    wrong = {
        **{flag: True for one in of_trial for flag in one.flags()},
        **{f"mvc_{flag}": True for one in of_mvc for flag in one.flags()},
        "no_rest": not np.isfinite(ratio),
        "mvc_too_small": ratio < settings.least_mvc_ratio,
        "above_mvc": above > 0,
        "level_clamped": levels.clamped_low_count + levels.clamped_high_count > 0,
    }
    return EmgAnalysis(
        envelopes=envelopes,
        normalised=np.array([normalise(s, m) for s, m in zip(envelopes, known.maxima, strict=True)]),
        cocontraction=value,
        trusted=trusted,
        bursts=bursts,
        peaks=peaks,
        levels=levels,
        runs=_runs(peaks, levels.index.tolist(), trusted),
        maxima=known.maxima,
        reference=known.reference,
        on=rule.on,
        off=rule.off,
        mvc_ratio=ratio,
        above_mvc_count=above,
        quality=of_trial,
        flags=tuple(flag for flag, is_so in wrong.items() if is_so),
    )


def second_eigenvalue(runs: list[list[int]]) -> float:
    """Return the modulus of lambda_2 of the matrix with Jeffreys' prior; NaN where there is no transition."""
    counts = count_transitions([run for run in runs if run], LEVEL_COUNT)
    if counts.sum() == 0.0:
        return float("nan")
    return float(np.sort(np.abs(eigenvalues(transition_matrix(counts))))[-2])


def _calibration(
    mvc: Float64Array, quiet: Sequence[Float64Array], settings: EmgSettings, *, rest_known: bool
) -> Calibration:
    """Return what a trial is measured against; envelopes are looked at as bursts are."""
    step = look_step(settings.rate_hz)
    return calibrate(
        mvc[:, ::step],
        np.concatenate([part[:, ::step] for part in quiet], axis=1),
        rate_hz=settings.rate_hz / step,
        window_s=settings.window_s,
        rule=settings.mvc_rule,
        rest_known=rest_known,
    )


def _envelopes(
    samples: Float64Array, settings: EmgSettings, offsets: Sequence[float] = ()
) -> tuple[Float64Array, BoolArray]:
    """Return envelopes of a recording and where they are trusted; without offsets, about its medians."""
    marks = [
        lost_samples(muscle, rate_hz=settings.rate_hz, rails=settings.rails, held_s=settings.held_s)
        for muscle in samples
    ]
    pairs = [bridge(np.where(lost, np.nan, muscle)) for lost, muscle in zip(marks, samples, strict=True)]
    offsets = offsets or [float(np.median(whole)) for whole, _ in pairs]
    chains = [settings.chain(offset) for offset in offsets]
    found = np.array([chain.envelope(whole) for chain, (whole, _) in zip(chains, pairs, strict=True)])
    lost = np.logical_or.reduce([lost for _, lost in pairs])
    return found, ~_smeared(lost, chains[0].window_samples)


def _smeared(lost: BoolArray, window: int) -> BoolArray:
    """Return which envelope values rest on a lost sample or on the bridge's end inside the window."""
    return np.asarray(np.convolve(lost, np.ones(window + 1), mode="full")[: lost.size] > 0.5)


def _runs(peaks: list[EmgPeak], levels: list[int], trusted: BoolArray) -> list[list[int]]:
    gap_number = np.cumsum(~trusted)
    runs: dict[int, list[int]] = {}
    for peak, level in zip(peaks, levels, strict=True):
        runs.setdefault(int(gap_number[peak.index]), []).append(level)
    return list(runs.values())
