"""What the study ``features`` measures: every way to a feature, on simulated sweeps whose truth is known."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from palp_core.graph.clock import monotonic_ns
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal import smoothers
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.wavelet import edge_cone, universal_threshold
from palp_core.palpation.perception.signal.wavelet_stream import WaveletStream, WaveletStreamState
from palp_core.palpation.studies.simulation.reading_table import (
    FROM_M,
    RATE_HZ,
    SPEED_M_PER_S,
    TO_M,
    Gel,
    sweep_torque,
)
from palp_core.units import Float64Array

BLOCK = 50

FEATURES: dict[str, Callable[..., float]] = {
    "peak": lambda torque, edge: peak(torque, edge=edge).value_n_m,
    "contrast": lambda torque, edge: contrast(torque, edge=edge).value_n_m,
}


@dataclass(frozen=True, eq=False)
class Way:
    """A way to take the noise off, with its settings.

    Attributes:
        family: What it is a setting of: ``wavelet``, ``wavelet stream``, ``savitzky_golay``, ...
        label: Its setting, for people.
        lag_s: How long after a sample its value is known.
        edge: Samples at each end that the feature must leave out.
        apply: Returns the smoothed sweep; the second argument is the sensor's noise, N m, as stated
            beforehand.
    """

    family: str
    label: str
    lag_s: float
    edge: int
    apply: Callable[[Float64Array, float], Float64Array]


@dataclass(frozen=True, eq=False)
class CleanSweep:
    """A sweep without noise, and the truth.

    Attributes:
        depth_m: Nodule's depth.
        ring_m: Ring position.
        torque_n_m: True torque at every sample, shape (n,).
        truth_n_m: Each feature of it.
        gap_n_m: Each feature's least distance to that of another depth at this ring.
    """

    depth_m: float
    ring_m: float
    torque_n_m: Float64Array
    truth_n_m: dict[str, float]
    gap_n_m: dict[str, float]


@dataclass(frozen=True)
class FeatureError:
    """How wrong a way is.

    Attributes:
        way: Which.
        feature: ``peak`` or ``contrast``.
        noise_factor: Sensor noise in steps of its resolution.
        rms_n_m: Root mean square error over sweeps and cases.
        bias_n_m: Mean error.
        relative: Root mean square of the error over the case's gap between depths.
        cost_s: Median CPU for a sweep, the feature included.
    """

    way: Way
    feature: str
    noise_factor: float
    rms_n_m: float
    bias_n_m: float
    relative: float
    cost_s: float


def ways(*, quick: bool = False) -> list[Way]:
    """Return every way, from nothing at all to the offline wavelet."""
    found = [Way("none", "none", 0.0, 0, _plain(smoothers.Nothing()))]
    for cutoff_hz in (10.0, 40.0) if quick else (5.0, 10.0, 20.0, 40.0, 80.0):
        low = smoothers.LowPass(cutoff_hz / RATE_HZ)
        found.append(Way("low_pass", f"{cutoff_hz:g} Hz", low.lag / RATE_HZ, low.edge, _plain(low)))
    for half in (50, 200) if quick else (25, 50, 100, 200, 400):
        fitted, label = smoothers.SavitzkyGolay(half), f"{2 * half + 1} ms"
        found.append(Way("savitzky_golay", label, half / RATE_HZ, half, _plain(fitted)))
    cone = edge_cone()
    for lag in (100, cone) if quick else (50, 100, 200, 300, cone):
        lag_s, label = lag / RATE_HZ, f"{lag} ms"
        found += [
            Way("db10 soft, stream", label, lag_s, cone, partial(_stream, lag=lag)),
            Way("db10 approximation, stream", label, lag_s, cone, partial(_linear, lag=lag)),
        ]
    whole_s = (TO_M - FROM_M) / SPEED_M_PER_S
    found += [
        Way("db10 soft, offline", "sweep", whole_s, cone, _plain(smoothers.WaveletSoft())),
        Way("db10 approximation, offline", "sweep", whole_s, cone, _plain(smoothers.WaveletApproximation())),
    ]
    return found


def _plain(used: smoothers.Smoother) -> Callable[[Float64Array, float], Float64Array]:
    return lambda signal, _: used.apply(signal)


def _stream(signal: Float64Array, noise_sd_n_m: float, *, lag: int) -> Float64Array:
    return _streamed(WaveletStream(threshold=universal_threshold(noise_sd_n_m, signal.size), lag=lag), signal)


def _linear(signal: Float64Array, _: float, *, lag: int) -> Float64Array:
    return _streamed(WaveletStream("approximation", lag=lag), signal)


def _streamed(stream: WaveletStream, signal: Float64Array) -> Float64Array:
    state, parts = WaveletStreamState(), []
    for begin in range(0, signal.size, BLOCK):
        state, out = stream.step(state, signal[begin : begin + BLOCK])
        parts.append(out)
    return np.concatenate([*parts, stream.finish(state)])


def clean_cases(rings_m: tuple[float, ...], gel: Gel | None = None) -> list[CleanSweep]:
    """Return sweeps over phantoms without noise.

    Args:
        rings_m: Ring positions.
        gel: What is touched, and at which depths; None: the paper's.
    """
    touched, cases = gel or Gel(), []
    for ring_m in rings_m:
        torques = [sweep_torque(touched, depth_m, ring_m) for depth_m in touched.depths_m]
        cone = edge_cone()
        truths = [{name: of(torque, cone) for name, of in FEATURES.items()} for torque in torques]
        for depth_m, torque, truth in zip(touched.depths_m, torques, truths, strict=True):
            gaps = {
                name: min(abs(other[name] - truth[name]) for other in truths if other is not truth)
                for name in FEATURES
            }
            cases.append(CleanSweep(depth_m, ring_m, torque, truth, gaps))
    return cases


def measure(
    way: Way, cases: list[CleanSweep], noise_factor: float, sweep_count: int, rng: np.random.Generator
) -> list[FeatureError]:
    """Return how wrong a way is, a row per feature; the same generator gives every way the same noise.

    Args:
        way: Which.
        cases: On which sweeps.
        noise_factor: Noise in steps of the sensor's resolution, to which it is rounded.
        sweep_count: Noisy sweeps per case.
        rng: Of the noise.
    """
    noise_sd_n_m = noise_factor * RESOLUTION_N_M
    stated_n_m = float(np.hypot(noise_sd_n_m, RESOLUTION_N_M / np.sqrt(12.0)))
    errors: dict[str, list[float]] = {name: [] for name in FEATURES}
    shares: dict[str, list[float]] = {name: [] for name in FEATURES}
    costs: dict[str, list[float]] = {name: [] for name in FEATURES}
    for case in cases:
        for _ in range(sweep_count):
            noisy = case.torque_n_m + noise_sd_n_m * rng.standard_normal(case.torque_n_m.size)
            noisy = np.rint(noisy / RESOLUTION_N_M) * RESOLUTION_N_M
            begin_ns = monotonic_ns()
            smooth = way.apply(noisy, stated_n_m)
            smooth_ns = monotonic_ns() - begin_ns
            for name, of in FEATURES.items():
                begin_ns = monotonic_ns()
                error = of(smooth, way.edge) - case.truth_n_m[name]
                costs[name].append((smooth_ns + monotonic_ns() - begin_ns) * 1e-9)
                errors[name].append(error)
                shares[name].append(error / case.gap_n_m[name])
    return [
        FeatureError(
            way,
            name,
            noise_factor,
            float(np.sqrt(np.mean(np.square(errors[name])))),
            float(np.mean(errors[name])),
            float(np.sqrt(np.mean(np.square(shares[name])))),
            float(np.median(costs[name])),
        )
        for name in FEATURES
    ]
