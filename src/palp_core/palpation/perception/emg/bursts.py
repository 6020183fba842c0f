"""Bursts of co-contraction by two thresholds, with the peaks within them, while it streams.

A burst begins where co-contraction exceeds a threshold above rest and ends below a lower one. Short gaps are
joined, short bursts dropped; a contraction that is held is one burst, however long. Within it valleys
separate peaks. Co-contraction is looked at every 10 ms, counted from the first sample, so the same bursts
come out whatever the blocks, to the bit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.calibration import Calibration, look_step
from palp_core.palpation.perception.emg.settings import BURSTS, LOOK_S, BurstSettings
from palp_core.units import Float64Array

_LEAST_TOP = 4  # looks of a top that a parabola is laid through
_MOST_LOOKS = 4096  # of one peak; beyond, every other one is forgotten


@dataclass(frozen=True)
class EmgPeak:
    """A peak of co-contraction."""

    index: int  # Its sample; of a flat top the middle
    value: float  # Co-contraction there, dimensionless
    known_at: int  # The sample that settled it; `known_at - index` is its lag
    level: float  # Its strength, dimensionless; `value` where nothing is known of its noise


@dataclass(frozen=True)
class Burst:
    """A contraction."""

    begin: int  # Sample at which it exceeds the upper threshold
    end: int  # Sample at which it sinks below the lower one
    peaks: tuple[EmgPeak, ...]  # Its peaks, at least one
    known_at: int  # The sample that settled it


@dataclass
class OpenPeak:
    """The peak that is followed."""

    index: int  # Sample of its largest value
    value: float  # That value
    looks: list[float] = field(default_factory=list)  # Of it from its begin on, or every `stride`-th of them
    stride: int = 1  # Looks from one that is kept to the next
    count: int = 0  # Looks so far


@dataclass
class BurstState:
    """What is remembered between two blocks: plain data, to be kept in a node's state."""

    sample_count: int = 0  # Samples seen
    begin: int = -1  # First sample of the burst that goes on; -1: there is none
    below: int = -1  # Since which sample it is below the lower threshold; -1: it is not
    peaks: list[EmgPeak] = field(default_factory=list)  # Peaks of the burst so far
    out_count: int = 0  # How many of them were put out
    hump: OpenPeak | None = None  # The peak that is followed; None: a valley is
    valley: float = math.inf  # Smallest value of that valley
    sunk: int = -1  # Since which sample it is one; -1: there is none, or the scatter's, and the peak goes on
    still: list[float] = field(default_factory=list)  # Its last looks, as long as a shelf is

    def copied(self) -> "BurstState":
        """Return a state that shares nothing with this one that changes."""
        hump = None if self.hump is None else replace(self.hump, looks=[*self.hump.looks])
        return replace(self, peaks=[*self.peaks], hump=hump, still=[*self.still])


@dataclass(frozen=True)
class Found:
    """What a block settles; the peaks of a burst come before it, as soon as it is sure to be one."""

    peaks: tuple[EmgPeak, ...]
    bursts: tuple[Burst, ...]


@dataclass(frozen=True)
class BurstRule:
    """The rule of two thresholds."""

    rate_hz: float  # Sampling rate of the co-contraction
    rest: float = 0.0  # Co-contraction at rest, dimensionless
    rest_sd: float = 0.0  # Standard deviation of it, dimensionless
    settings: BurstSettings = BURSTS  # Thresholds and times
    window_s: float = 0.0  # RMS window behind the co-contraction; 0: none

    def __post_init__(self) -> None:
        if not (self.rate_hz > 0.0 and math.isfinite(self.rate_hz)):
            raise PerceptionError(f"burst rule: rate_hz is {self.rate_hz}; it must be positive and finite")
        for name in ("rest", "rest_sd", "window_s"):
            if not (getattr(self, name) >= 0.0 and math.isfinite(getattr(self, name))):
                raise PerceptionError(f"burst rule: {name} is {getattr(self, name)}; record rest again")

    @classmethod
    def of(cls, rate_hz: float, known: Calibration, settings: BurstSettings = BURSTS) -> "BurstRule":
        """Return the rule for co-contraction that is measured against a calibration."""
        return cls(rate_hz, known.rest, known.rest_sd, settings, known.window_s)

    @property
    def on(self) -> float:
        """Upper threshold, dimensionless."""
        return self._above_rest(self.settings.on_share, self.settings.rest_spreads)

    @property
    def off(self) -> float:
        """Lower threshold, dimensionless."""
        return min(self.on, self._above_rest(self.settings.off_share, self.settings.rest_spreads / 2.0))

    def _above_rest(self, share: float, spreads: float) -> float:
        return self.rest + max(share * max(0.0, 1.0 - self.rest), spreads * self.rest_sd)

    def step(self, state: BurstState, values: Float64Array) -> tuple[BurstState, Found]:
        """Return the next state and what this block settles, in its order."""
        if not np.isfinite(values).all():
            raise PerceptionError("co-contraction holds NaN or infinity; bridge the gap before it gets here")
        state, step = state.copied(), look_step(self.rate_hz)
        detector, first = _BurstDetector(self, state), -state.sample_count % step
        looks = np.asarray(values[first::step], dtype=np.float64).tolist()
        for number, value in enumerate(looks):
            detector.look(state.sample_count + first + number * step, value)
        state.sample_count += len(values)
        return state, detector.found()

    def finish(self, state: BurstState) -> Found:
        """Return what is still open at the end of the recording; a burst that goes on ends there."""
        detector, last = _BurstDetector(self, state.copied()), state.sample_count - 1
        if state.begin >= 0:
            detector.close(last if state.below < 0 else state.below, last)
        return detector.found()

    def whole(self, values: Float64Array) -> Found:
        """Return all bursts and peaks of a recording."""
        state, found = self.step(BurstState(), values)
        last = self.finish(state)
        return Found(found.peaks + last.peaks, found.bursts + last.bursts)

    def strength(self, value: float) -> float:
        """Return co-contraction without rest; noise and mains add to muscle in power."""
        return math.sqrt(max(0.0, value * value - self.rest * self.rest))

    def level(self, value: float, looks: Sequence[float]) -> float:
        """Return the strength of a peak, of an MVC that is as free of rest.

        It is what the parabola of least squares gives for the middle of its top: of a contraction that is
        held its mean, of one that swells what it swells to. The top lasts from the first look above a share
        of the largest to the last, less what the RMS window takes at either end to fill or empty from there.
        """
        share = self.settings.top_share
        strengths = np.array([self.strength(one) for one in looks])
        above = np.flatnonzero(strengths >= share * self.strength(value))
        top = strengths[above[0] : above[-1] + 1] if above.size else np.array([self.strength(value)])
        filling = round((1.0 - share**2) * self.window_s / LOOK_S)  # of a step, power goes in a line
        if top.size >= 2 * filling + _LEAST_TOP:
            top = top[filling : top.size - filling]
        strength = float(top.mean())
        if top.size >= _LEAST_TOP:
            strength += max(0.0, _crest(top))
        return strength / math.sqrt(max(1.0 - self.rest * self.rest, 1e-9))


def _crest(values: Float64Array) -> float:
    """Return by how much the middle of the parabola of least squares exceeds the mean."""
    square = np.linspace(-1.0, 1.0, values.size) ** 2
    centred = square - square.mean()
    return -float(square.mean() * (values @ centred) / (centred @ centred))


class _BurstDetector:
    """The rule applied to a block; it changes the state."""

    def __init__(self, rule: BurstRule, state: BurstState) -> None:
        self.rule, self.state, self.on, self.off = rule, state, rule.on, rule.off
        self.least = rule.settings.least_s * rule.rate_hz
        self.gap = rule.settings.gap_s * rule.rate_hz
        self.step = look_step(rule.rate_hz)
        self.shelf = round(rule.settings.shelf_s * rule.rate_hz / self.step)
        self.peaks: list[EmgPeak] = []
        self.bursts: list[Burst] = []

    def found(self) -> Found:
        """Return what came out."""
        return Found(tuple(self.peaks), tuple(self.bursts))

    def look(self, at: int, value: float) -> None:
        """Take in the value at a sample."""
        state = self.state
        if state.begin < 0 and value < self.on:
            return
        if state.begin < 0:
            state.begin, state.hump = at, OpenPeak(at, value)
        state.below = -1 if value >= self.off else at if state.below < 0 else state.below
        self._follow(at, value)
        if state.below < 0 and at - state.begin >= self.least:
            self._release(at)
        elif state.below >= 0 and at - state.below >= self.gap:
            self.close(state.below, at)

    def close(self, end: int, at: int) -> None:
        """End the burst that goes on; a short one was none."""
        state = self.state
        if end - state.begin >= self.least:
            self._settle(at)
            self._release(at)
            self.bursts.append(Burst(state.begin, end, tuple(state.peaks), at))
        state.begin, state.below, state.peaks, state.out_count = -1, -1, [], 0
        state.hump, state.valley, state.sunk, state.still = None, math.inf, -1, []

    def _follow(self, at: int, value: float) -> None:
        """Follow the peak to its valley, or the valley to the next peak."""
        state, strength, share = self.state, self.rule.strength, self.rule.settings.valley_share
        if state.hump is None:
            state.valley = min(state.valley, value)
            if value >= self.on and share * strength(value) >= strength(state.valley):
                state.hump, state.still = OpenPeak(at, value), []
            else:
                state.hump = self._shelf(at, value)
        hump = state.hump
        if hump is None:
            return
        if strength(value) <= share * strength(hump.value):
            self._settle(at)
            state.valley, state.sunk = value, at
            return
        if hump.count % hump.stride == 0:
            hump.looks.append(value)
        if len(hump.looks) > _MOST_LOOKS:
            hump.looks, hump.stride = hump.looks[::2], 2 * hump.stride
        hump.count += 1
        if value > hump.value:
            hump.index, hump.value = at, value

    def _shelf(self, at: int, value: float) -> OpenPeak | None:
        """Return the peak of a level that was held without a rise, once there is one.

        A valley that is over before a gap is joined is the scatter's, and what follows no level of its own.
        """
        state, strength, settings = self.state, self.rule.strength, self.rule.settings
        sunken = strength(value) <= settings.valley_share * strength(state.peaks[-1].value)
        if sunken and state.sunk < 0:
            state.sunk = at
        elif not sunken and at - state.sunk <= self.gap:
            state.sunk = -1
        state.still = [*state.still, value][-self.shelf :] if self.shelf and state.sunk >= 0 else []
        if not state.still or len(state.still) < self.shelf:
            return None
        before, top = state.still[:-1], max(state.still)
        if top < self.on or strength(min(state.still)) < settings.top_share * strength(top):
            return None
        index = at - (len(before) - state.still.index(top)) * self.step
        state.still = []
        return OpenPeak(index, top, before, 1, len(before))

    def _settle(self, at: int) -> None:
        """End the peak that is followed, if one is."""
        if (hump := self.state.hump) is not None:
            level = self.rule.level(hump.value, hump.looks)
            self.state.peaks.append(EmgPeak(hump.index, hump.value, at, level))
        self.state.hump = None

    def _release(self, at: int) -> None:
        """Put out the peaks that are not out yet: their burst is sure."""
        peaks, first = self.state.peaks, self.state.out_count
        peaks[first:] = [replace(peak, known_at=at) for peak in peaks[first:]]
        self.peaks += peaks[first:]
        self.state.out_count = len(peaks)
