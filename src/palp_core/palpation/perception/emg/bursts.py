"""Bursts of co-contraction by two thresholds, with the peaks within them, while it streams.

A burst begins where co-contraction exceeds a threshold above rest and ends below a lower one. Short gaps are
joined, short bursts dropped; a contraction that is held is one burst, however long. Within it peaks are told
apart by valleys. Co-contraction is looked at every 10 ms, counted from the first sample, so the same bursts
come out whatever the blocks, to the bit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.calibration import Calibration, look_step
from palp_core.palpation.perception.emg.settings import BURSTS, LOOK_S, BurstSettings
from palp_core.units import Float64Array

_LEAST_TOP = 4  # looks of a top that a parabola is laid through
_MOST_LOOKS = 4096  # of one peak; beyond, every other one is forgotten


@dataclass(frozen=True)
class EmgPeak:
    """A peak of co-contraction.

    Attributes:
        index: Its sample; of a flat top the middle.
        value: Co-contraction there, dimensionless.
        known_at: The sample that settled it; ``known_at - index`` is its lag.
        level: Strength that it stands for, dimensionless; ``value`` where nothing is known of its noise.
    """

    index: int
    value: float
    known_at: int
    level: float


@dataclass(frozen=True)
class Burst:
    """A contraction.

    Attributes:
        begin: Sample at which it exceeds the upper threshold.
        end: Sample at which it sinks below the lower one.
        peaks: Its peaks, at least one.
        known_at: The sample that settled it.
    """

    begin: int
    end: int
    peaks: tuple[EmgPeak, ...]
    known_at: int


@dataclass(frozen=True)
class OpenPeak:
    """The peak that is followed.

    Attributes:
        index: Sample of its largest value.
        value: That value.
        looks: What was seen of it from its begin on, or every ``stride``-th of that.
        stride: Looks from one that is kept to the next.
        count: Looks so far.
    """

    index: int
    value: float
    looks: tuple[float, ...] = ()
    stride: int = 1
    count: int = 0


@dataclass(frozen=True)
class BurstState:
    """What is remembered between two blocks: plain data, to be kept in a node's state.

    Attributes:
        sample_count: Samples seen.
        begin: First sample of the burst that goes on; -1: there is none.
        below: Since which sample it is below the lower threshold; -1: it is not.
        peaks: Peaks of the burst so far.
        told: How many of them were told.
        hump: The peak that is followed; None: a valley is.
        valley: Smallest value of that valley.
        sunk: Since which sample it is one; -1: there is none, or the scatter's, and the peak goes on.
        still: Its last looks, as long as a shelf is.
    """

    sample_count: int = 0
    begin: int = -1
    below: int = -1
    peaks: tuple[EmgPeak, ...] = ()
    told: int = 0
    hump: OpenPeak | None = None
    valley: float = math.inf
    sunk: int = -1
    still: tuple[float, ...] = ()


@dataclass(frozen=True)
class Found:
    """What a block settles; the peaks of a burst come before it, as soon as it is sure to be one."""

    peaks: tuple[EmgPeak, ...]
    bursts: tuple[Burst, ...]


@dataclass(frozen=True)
class BurstRule:
    """The rule of two thresholds.

    Attributes:
        rate_hz: Sampling rate of the co-contraction.
        rest: Co-contraction at rest, dimensionless.
        rest_sd: Standard deviation of it, dimensionless.
        settings: Thresholds and times.
        window_s: RMS window behind the co-contraction; 0: none.

    Raises:
        PerceptionError: The rate is not positive, or rest is negative or no number.
    """

    rate_hz: float
    rest: float = 0.0
    rest_sd: float = 0.0
    settings: BurstSettings = BURSTS
    window_s: float = 0.0

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
        """Return the next state and what this block settles, in its order.

        Args:
            state: ``BurstState()`` at first, then what the previous block left.
            values: Co-contraction, shape (n,); n may be 0.

        Raises:
            PerceptionError: A value is NaN or infinite.
        """
        if not np.isfinite(values).all():
            raise PerceptionError("co-contraction holds NaN or infinity; bridge the gap before it gets here")
        step = look_step(self.rate_hz)
        first = -state.sample_count % step
        machine = _BurstDetector(self, state)
        for at, value in zip(
            range(state.sample_count + first, state.sample_count + len(values), step),
            np.asarray(values[first::step], dtype=np.float64).tolist(),
            strict=True,
        ):
            machine.look(at, value)
        return machine.left(state.sample_count + len(values))

    def finish(self, state: BurstState) -> Found:
        """Return what is still open at the end of the recording; a burst that goes on ends there."""
        machine, last = _BurstDetector(self, state), state.sample_count - 1
        if state.begin >= 0:
            machine.close(last if state.below < 0 else state.below, last)
        return machine.left(state.sample_count)[1]

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

        Args:
            value: Largest co-contraction.
            looks: Co-contraction from look to look.
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
    """The rule at work on a block: the state, unpacked."""

    def __init__(self, rule: BurstRule, state: BurstState) -> None:
        self.rule, self.on, self.off = rule, rule.on, rule.off
        self.least = rule.settings.least_s * rule.rate_hz
        self.gap = rule.settings.gap_s * rule.rate_hz
        self.begin, self.below = state.begin, state.below
        self.peaks, self.told = list(state.peaks), state.told
        self.hump, self.valley, self.sunk, self.still = (
            state.hump,
            state.valley,
            state.sunk,
            list(state.still),
        )
        self.step = look_step(rule.rate_hz)
        self.shelf = round(rule.settings.shelf_s * rule.rate_hz / self.step)
        self.looks = list(state.hump.looks) if state.hump else []
        self.peaks_out: list[EmgPeak] = []
        self.bursts_out: list[Burst] = []

    def look(self, at: int, value: float) -> None:
        """Take in the value at a sample."""
        if self.begin < 0 and value < self.on:
            return
        if self.begin < 0:
            self.begin, self.hump = at, OpenPeak(at, value)
        self.below = -1 if value >= self.off else at if self.below < 0 else self.below
        self._follow(at, value)
        if self.below < 0 and at - self.begin >= self.least:
            self._release(at)
        elif self.below >= 0 and at - self.below >= self.gap:
            self.close(self.below, at)

    def close(self, end: int, at: int) -> None:
        """End the burst that goes on; a short one was none."""
        if end - self.begin >= self.least:
            self._settle(at)
            self._release(at)
            self.bursts_out.append(Burst(self.begin, end, tuple(self.peaks), at))
        self.begin, self.below, self.peaks, self.told = -1, -1, [], 0
        self.hump, self.looks, self.valley, self.sunk, self.still = None, [], math.inf, -1, []

    def left(self, sample_count: int) -> tuple[BurstState, Found]:
        """Return the state after the block, and what came out."""
        hump = replace(self.hump, looks=tuple(self.looks)) if self.hump else None
        state = BurstState(
            sample_count,
            self.begin,
            self.below,
            tuple(self.peaks),
            self.told,
            hump,
            self.valley,
            self.sunk,
            tuple(self.still),
        )
        return state, Found(tuple(self.peaks_out), tuple(self.bursts_out))

    def _follow(self, at: int, value: float) -> None:
        """Follow the peak to its valley, or the valley to the next peak."""
        strength, share = self.rule.strength, self.rule.settings.valley_share
        hump = self.hump
        if hump is None:
            self.valley = min(self.valley, value)
            if value >= self.on and share * strength(value) >= strength(self.valley):
                hump, self.looks, self.still = OpenPeak(at, value), [], []
            else:
                hump = self._shelf(at, value)
            if hump is None:
                return
        if strength(value) <= share * strength(hump.value):
            self._settle(at)
            self.valley, self.sunk = value, at
            return
        if hump.count % hump.stride == 0:
            self.looks.append(value)
        stride = hump.stride
        if len(self.looks) > _MOST_LOOKS:
            self.looks, stride = self.looks[::2], 2 * stride
        index, top = (at, value) if value > hump.value else (hump.index, hump.value)
        self.hump = OpenPeak(index, top, (), stride, hump.count + 1)

    def _shelf(self, at: int, value: float) -> OpenPeak | None:
        """Return the peak of a level that was held without a rise, once there is one.

        A valley that is over before a gap is joined is the scatter's, and what follows no level of its own.
        """
        strength, settings = self.rule.strength, self.rule.settings
        sunken = strength(value) <= settings.valley_share * strength(self.peaks[-1].value)
        if sunken and self.sunk < 0:
            self.sunk = at
        elif not sunken and at - self.sunk <= self.gap:
            self.sunk = -1
        self.still = [*self.still, value][-self.shelf :] if self.shelf and self.sunk >= 0 else []
        if not self.still or len(self.still) < self.shelf:
            return None
        before, top = self.still[:-1], max(self.still)
        if top < self.on or strength(min(self.still)) < settings.top_share * strength(top):
            return None
        index = at - (len(before) - self.still.index(top)) * self.step
        self.looks, self.still = before, []
        return OpenPeak(index, top, (), 1, len(before))

    def _settle(self, at: int) -> None:
        """End the peak that is followed, if one is."""
        if self.hump is not None:
            level = self.rule.level(self.hump.value, self.looks)
            self.peaks.append(EmgPeak(self.hump.index, self.hump.value, at, level))
        self.hump, self.looks = None, []

    def _release(self, at: int) -> None:
        """Put out the peaks that are not out yet: their burst is sure."""
        self.peaks[self.told :] = [replace(one, known_at=at) for one in self.peaks[self.told :]]
        self.peaks_out += self.peaks[self.told :]
        self.told = len(self.peaks)
