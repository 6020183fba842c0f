"""Simulated EMG of two finger muscles: noise in a band, as strong as a Markov chain of levels says.

It starts with a rest, a maximum voluntary contraction (MVC) and another rest; then the palpation goes on for
ever. Both muscles share one normalised envelope, so their normalised co-contraction is the chain's level.
Between two levels they relax a little: successive equal levels stay two peaks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import msgspec
import numpy as np
import scipy

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import EmgSamples
from palp_core.palpation.devices.sim import Simulated
from palp_core.units import Float64Array

_NS = 1e9
_ORDER = 2  # of the low-pass prototype: a band-pass of twice this order
_MUSCLES = 2


class SimEmgState(msgspec.Struct):
    """What the source carries from block to block.

    Attributes:
        started: Whether the source was brought up.
        start_ns: Time of sample 0.
        sample_count: Samples delivered so far; also the index of the next one.
        level: Index of the present level, -1 before the palpation.
        left_count: Samples left of the present level.
        band_filter: State of the band-pass, ``_ORDER`` sections by 2 by 2 muscles, in C order.
        envelope_filter: State of the smoothing, 1 section by 2.
    """

    started: bool = False
    start_ns: int = 0
    sample_count: int = 0
    level: int = -1
    left_count: int = 0
    band_filter: list[float] = msgspec.field(default_factory=lambda: [0.0] * (_ORDER * 2 * _MUSCLES))
    envelope_filter: list[float] = msgspec.field(default_factory=lambda: [0.0, 0.0])


@dataclass(frozen=True)
class SimEmg(Simulated):
    """Parameters of the muscles and of an amplifier like the Noraxon Desktop DTS.

    Attributes:
        matrix: Transition probabilities M[next, current] between levels, shape (k, k); columns sum to 1.
        levels: Normalised co-contraction per state of the chain, shape (k,) (the paper: 0.1 to 0.5 of MVC).
        rate_hz: Sampling rate (the paper: 1500 Hz).
        band_hz: Pass band of the noise (the usual 20 to 450 Hz of surface EMG).
        fds_mvc_v: RMS of FDS at MVC (assumed).
        edc_mvc_v: RMS of EDC at MVC (assumed).
        offset_v: Electrode offset, the same at both (assumed).
        noise_sd_v: Amplifier noise per sample (assumed).
        rest_s: Duration of each rest (assumed).
        mvc_s: Duration of the MVC (assumed).
        dwell_s: Mean time at one level, > ``shortest_dwell_s``; times are exponential beyond the shortest
            (assumed).
        shortest_dwell_s: Shortest time at one level, relaxation included (assumed).
        relax_s: Time of relaxation at the end of each level, < ``shortest_dwell_s`` (assumed).
        relax_share: Share of the level given up in it (assumed); 0 makes plateaus without valleys.
        smooth_s: Time constant of each of the two equal lags between level and envelope (assumed).
    """

    state_type: ClassVar[type[SimEmgState]] = SimEmgState

    matrix: Sequence[Sequence[float]] | Float64Array  # kept as a tuple of rows
    levels: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5)
    rate_hz: float = 1500.0
    band_hz: tuple[float, float] = (20.0, 450.0)
    fds_mvc_v: float = 300e-6
    edc_mvc_v: float = 250e-6
    offset_v: float = 20e-6
    noise_sd_v: float = 1e-6
    rest_s: float = 2.0
    mvc_s: float = 5.0
    dwell_s: float = 1.0
    shortest_dwell_s: float = 0.5
    relax_s: float = 0.2
    relax_share: float = 0.5
    smooth_s: float = 0.03

    def __post_init__(self) -> None:
        check_range("emg", "rate_hz", self.rate_hz, 1.0, 1e5)
        check_range("emg", "band_hz low", self.band_hz[0], 1e-3, self.rate_hz / 2.0)
        check_range("emg", "band_hz high", self.band_hz[1], self.band_hz[0] * 1.01, self.rate_hz / 2.0 * 0.99)
        for name in ("fds_mvc_v", "edc_mvc_v", "noise_sd_v"):
            check_range("emg", name, getattr(self, name), 0.0, 1.0)
        check_range("emg", "offset_v", self.offset_v, -10.0, 10.0)
        for name in ("rest_s", "mvc_s"):
            check_range("emg", name, getattr(self, name), 0.0, 3600.0)
        check_range("emg", "shortest_dwell_s", self.shortest_dwell_s, 1.0 / self.rate_hz, 3600.0)
        check_range("emg", "dwell_s", self.dwell_s, self.shortest_dwell_s, 3600.0)
        check_range("emg", "relax_s", self.relax_s, 0.0, self.shortest_dwell_s)
        check_range("emg", "relax_share", self.relax_share, 0.0, 1.0)
        check_range("emg", "smooth_s", self.smooth_s, 0.0, 60.0)
        for level in self.levels:
            check_range("emg", "levels", level, 0.0, 1.0)
        self._check_matrix()

    def _check_matrix(self) -> None:
        try:
            matrix = np.array(self.matrix, dtype=np.float64)
        except ValueError as error:
            raise DeviceError(f"emg: matrix is not an array of numbers: {error}; give k rows of k") from error
        k = len(self.levels)
        if (
            matrix.shape != (k, k)
            or not np.all(matrix >= 0.0)
            or not np.allclose(matrix.sum(axis=0), 1.0, atol=1e-6)
        ):
            raise DeviceError(
                f"emg: matrix of shape {matrix.shape} is not M[next, current] over {k} levels;"
                " give non-negative columns that sum to 1"
            )
        object.__setattr__(self, "matrix", tuple(tuple(row) for row in matrix.tolist()))

    def mvc_ns(self, state: SimEmgState) -> tuple[int, int]:
        """Return begin and end of the MVC in ns."""
        return self._stamp_ns(self._count(self.rest_s), state), self._stamp_ns(self._mvc_end, state)

    def palpation_ns(self, state: SimEmgState) -> int:
        """Return the begin of the palpation in ns."""
        return self._stamp_ns(self._palpation_begin, state)

    def open(self, now_ns: int, state: SimEmgState, rng: np.random.Generator) -> None:
        """Start a fresh source with sample 0 now; leave one that was started before as it is."""
        if state.level >= len(self.levels):
            raise DeviceError(
                f"emg: the state is at level {state.level} of {len(self.levels)}; use a fresh state"
            )
        if not state.started:
            state.start_ns = now_ns
            state.started = True

    def drain(self, now_ns: int, state: SimEmgState, rng: np.random.Generator) -> EmgSamples:
        """Return every sample since the last call up to and including ``now_ns``.

        Six numbers are drawn per sample in a fixed order, so the size of the blocks does not change the
        samples.
        """
        if not state.started:
            raise DeviceError("emg: not started; open it before the first drain")
        first, due = state.sample_count, self._due_count(now_ns, state)
        if due <= first:
            none = np.empty(0, dtype=np.int64)
            return EmgSamples(none, np.empty(0), np.empty(0), none, none.astype(np.bool_))
        draws = rng.standard_normal((due - first, 6))
        envelope = self._envelope(first, draws[:, 4:], state)
        noise = self._noise(draws[:, :2], state)
        state.sample_count = due
        sensor = self.offset_v + self.noise_sd_v * draws[:, 2:4]
        times_ns = state.start_ns + np.rint(np.arange(first, due) * _NS / self.rate_hz).astype(np.int64)
        fds_v = self.fds_mvc_v * envelope * noise[:, 0] + sensor[:, 0]
        edc_v = self.edc_mvc_v * envelope * noise[:, 1] + sensor[:, 1]
        index = np.arange(first, due)
        return EmgSamples(times_ns, fds_v, edc_v, index, np.zeros(due - first, dtype=np.bool_))

    def _count(self, duration_s: float) -> int:
        return round(duration_s * self.rate_hz)

    @property
    def _mvc_end(self) -> int:
        return self._count(self.rest_s) + self._count(self.mvc_s)

    @property
    def _palpation_begin(self) -> int:
        return self._mvc_end + self._count(self.rest_s)

    def _stamp_ns(self, index: int, state: SimEmgState) -> int:
        return state.start_ns + round(index * _NS / self.rate_hz)

    def _due_count(self, now_ns: int, state: SimEmgState) -> int:
        """Return how many samples have a stamp up to and including ``now_ns``."""
        count = max(0, math.floor((now_ns - state.start_ns) * self.rate_hz / _NS))
        while self._stamp_ns(count, state) <= now_ns:
            count += 1
        return count

    def _noise(self, draws: Float64Array, state: SimEmgState) -> Float64Array:
        """Return noise of unit variance within the band, shape (n, 2)."""
        sections, scale = _band_pass(self.rate_hz, *self.band_hz)
        before = np.reshape(state.band_filter, (_ORDER, 2, _MUSCLES))
        noise, after = scipy.signal.sosfilt(sections, draws, axis=0, zi=before)
        state.band_filter = after.ravel().tolist()
        return np.asarray(noise * scale, dtype=np.float64)

    def _envelope(self, first: int, draws: Float64Array, state: SimEmgState) -> Float64Array:
        """Return the smoothed envelope as a share of MVC, shape (n,)."""
        target = self._target(first, draws, state)
        pole = math.exp(-1.0 / (self.smooth_s * self.rate_hz)) if self.smooth_s > 0.0 else 0.0
        lag = np.array([[(1.0 - pole) ** 2, 0.0, 0.0, 1.0, -2.0 * pole, pole**2]])
        envelope, after = scipy.signal.sosfilt(lag, target, zi=np.array([state.envelope_filter]))
        state.envelope_filter = after.ravel().tolist()
        return np.asarray(envelope, dtype=np.float64)

    def _target(self, first: int, draws: Float64Array, state: SimEmgState) -> Float64Array:
        """Return what the muscles aim at, sample by sample: rest, MVC, rest, then the levels of the chain."""
        count = len(draws)
        target = np.zeros(count)
        target[max(0, self._count(self.rest_s) - first) : max(0, self._mvc_end - first)] = 1.0
        self._follow_chain(target, max(0, self._palpation_begin - first), draws, state)
        return target

    def _follow_chain(self, target: Float64Array, at: int, draws: Float64Array, state: SimEmgState) -> None:
        """Write the chain's levels into ``target`` from a sample on."""
        count, relax_count = len(target), self._count(self.relax_s)
        while at < count:
            if state.left_count == 0:
                self._step_chain(draws[at], state)
            until = min(count, at + state.left_count)
            relax_at = min(until, max(at, at + state.left_count - relax_count))
            target[at:relax_at] = self.levels[state.level]
            target[relax_at:until] = self.levels[state.level] * (1.0 - self.relax_share)
            state.left_count -= until - at
            at = until

    def _chain(self, state: SimEmgState) -> Float64Array:
        """Return the transition probabilities that hold now."""
        return np.asarray(self.matrix, dtype=np.float64)

    def _step_chain(self, draws: Float64Array, state: SimEmgState) -> None:
        """Draw the next level and its duration from two normal numbers; the first level is uniform."""
        k = len(self.levels)
        law = np.full(k, 1.0 / k) if state.level < 0 else self._chain(state)[:, state.level]
        share, survival = scipy.special.ndtr(draws[0]), scipy.special.ndtr(draws[1])
        possible = np.flatnonzero(law)
        place = int(np.searchsorted(np.cumsum(law[possible]), share, side="right"))
        state.level = int(possible[min(place, len(possible) - 1)])
        beyond_s = -(self.dwell_s - self.shortest_dwell_s) * math.log(max(survival, 1e-300))
        state.left_count = max(1, self._count(self.shortest_dwell_s + beyond_s))


@lru_cache(maxsize=8)
def _band_pass(rate_hz: float, low_hz: float, high_hz: float) -> tuple[Float64Array, float]:
    """Return the sections of a Butterworth band-pass, and the scale to unit variance for white noise.

    The variance of filtered white noise is the sum of the squared impulse response (Parseval).
    """
    sections = np.asarray(
        scipy.signal.butter(_ORDER, (low_hz, high_hz), btype="bandpass", fs=rate_hz, output="sos")
    )
    impulse = np.zeros(math.ceil(20.0 * rate_hz / low_hz))
    impulse[0] = 1.0
    return sections, float(1.0 / np.sqrt(np.sum(scipy.signal.sosfilt(sections, impulse) ** 2)))
