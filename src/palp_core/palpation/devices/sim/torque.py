"""A simulated torque sensor: gain, bias, drift, noise, range and resolution of one axis."""

import math
from dataclasses import dataclass
from typing import ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import Int64Array, TorqueSamples
from palp_core.palpation.devices.sim import Simulated
from palp_core.palpation.nano17 import RANGE_N_M, RESOLUTION_N_M
from palp_core.units import Float64Array


class SimTorqueState(msgspec.Struct):
    """What the sensor carries from block to block.

    Attributes:
        started: Whether the sensor was brought up.
        bias_n_m: Present bias.
        gain: Present gain, 1 for a true sensor.
        tare_n_m: What the host subtracts.
        last_ns: Time of the last sample.
        sample_count: Samples delivered so far.
    """

    started: bool = False
    bias_n_m: float = 0.0
    gain: float = 1.0
    tare_n_m: float = 0.0
    last_ns: int = 0
    sample_count: int = 0


@dataclass(frozen=True)
class SimTorque(Simulated):
    """Parameters of a sensor like the ATI Nano17 SI-12-0.12, torque about x.

    A sample is round((gain true + bias + noise) / resolution) resolution, clipped to the range, minus the
    tare. Bias and gain walk at random: after t seconds their standard deviation has grown to drift * sqrt(t).

    Attributes:
        noise_sd_n_m: Standard deviation of a sample's noise (assumed: one step of the resolution).
        resolution_n_m: Step (the maker's figure, 1/64 N mm; the paper's 0.015 N mm); 0 for none.
        range_n_m: Largest magnitude (the maker's figure, 120 N mm).
        bias_n_m: Bias at the start (0: tared).
        gain_error: Gain minus 1 at the start (0: calibrated).
        bias_drift_n_m_per_sqrt_s: Random walk of the bias (0: not known).
        gain_drift_per_sqrt_s: Random walk of the gain (0: not known).
        rate_hz: Sampling rate of :meth:`drain`; :meth:`read` samples at the times it is given.
    """

    state_type: ClassVar[type[SimTorqueState]] = SimTorqueState

    noise_sd_n_m: float = RESOLUTION_N_M
    resolution_n_m: float = RESOLUTION_N_M
    range_n_m: float = RANGE_N_M
    bias_n_m: float = 0.0
    gain_error: float = 0.0
    bias_drift_n_m_per_sqrt_s: float = 0.0
    gain_drift_per_sqrt_s: float = 0.0
    rate_hz: float = 1000.0

    def __post_init__(self) -> None:
        check_range("torque", "range_n_m", self.range_n_m, 1e-9, 1e3)
        for name in ("noise_sd_n_m", "resolution_n_m", "bias_drift_n_m_per_sqrt_s"):
            check_range("torque", name, getattr(self, name), 0.0, self.range_n_m)
        check_range("torque", "bias_n_m", self.bias_n_m, -self.range_n_m, self.range_n_m)
        check_range("torque", "gain_error", self.gain_error, -1.0, 1.0)
        check_range("torque", "gain_drift_per_sqrt_s", self.gain_drift_per_sqrt_s, 0.0, 1.0)
        check_range("torque", "rate_hz", self.rate_hz, 1.0, 1e5)

    def open(self, now_ns: int, state: SimTorqueState, rng: np.random.Generator) -> None:
        """Start a fresh sensor with its bias and gain error; leave one that was started before as it is."""
        if not state.started:
            state.bias_n_m, state.gain = self.bias_n_m, 1.0 + self.gain_error
            state.last_ns = now_ns
            state.started = True

    def drain(self, now_ns: int, state: SimTorqueState, rng: np.random.Generator) -> TorqueSamples:
        """Return the samples of the unloaded sensor since the last one, up to and including ``now_ns``."""
        period_ns = round(1e9 / self.rate_hz)
        times_ns = np.arange(state.last_ns + period_ns, now_ns + 1, period_ns, dtype=np.int64)
        return self.read(np.zeros(times_ns.size), times_ns, state, rng)

    def read(
        self,
        true_torque_n_m: Float64Array,
        times_ns: Int64Array,
        state: SimTorqueState,
        rng: np.random.Generator,
    ) -> TorqueSamples:
        """Return what the sensor says of a true torque.

        Three numbers are drawn per sample in a fixed order, so neither the size of the blocks nor a drift
        that is switched off changes the noise.
        """
        if not state.started:
            raise DeviceError("torque: not started; open it before the first read")
        if true_torque_n_m.shape != times_ns.shape or true_torque_n_m.ndim != 1:
            raise DeviceError(
                f"torque: {true_torque_n_m.shape} torques at {times_ns.shape} times; give one torque per time"
            )
        if times_ns.size == 0:
            return TorqueSamples(times_ns, np.empty(0), 0)
        if not math.isfinite(true_torque_n_m.sum()):
            raise DeviceError(f"torque: a true torque at or after {int(times_ns[0])} ns is not finite")
        draws = rng.standard_normal((times_ns.size, 3))
        bias_n_m, gain = self._drift(times_ns, draws, state)
        torque_n_m = gain * true_torque_n_m + bias_n_m + self.noise_sd_n_m * draws[:, 0]
        if self.resolution_n_m > 0.0:
            torque_n_m = np.rint(torque_n_m / self.resolution_n_m) * self.resolution_n_m
        saturated = np.abs(torque_n_m) >= self.range_n_m
        saturated_count = int(np.count_nonzero(saturated))
        if saturated_count:
            torque_n_m = np.clip(torque_n_m, -self.range_n_m, self.range_n_m)
        index = np.arange(state.sample_count, state.sample_count + times_ns.size)
        state.sample_count += times_ns.size
        gap = np.zeros(times_ns.size, dtype=np.bool_)
        return TorqueSamples(times_ns, torque_n_m - state.tare_n_m, saturated_count, index, gap, saturated)

    def tare(self, block: TorqueSamples, state: SimTorqueState) -> Float64Array:
        """Make the mean of ``block``, read unloaded, the new zero; return it, shape (1,)."""
        if block.torque_n_m.size == 0 or block.saturated_count:
            raise DeviceError(
                "torque: cannot tare from an empty or saturated block; unload the probe and read again"
            )
        state.tare_n_m += float(np.mean(block.torque_n_m))
        return np.array([state.tare_n_m])

    def _drift(
        self, times_ns: Int64Array, draws: Float64Array, state: SimTorqueState
    ) -> tuple[Float64Array | float, Float64Array | float]:
        """Return bias and gain of every sample, and keep the last ones."""
        last_ns = state.last_ns
        if self.bias_drift_n_m_per_sqrt_s == 0.0 and self.gain_drift_per_sqrt_s == 0.0:
            state.last_ns = int(times_ns[-1])
            return state.bias_n_m, state.gain
        steps_ns = np.empty_like(times_ns)
        steps_ns[0] = times_ns[0] - last_ns
        np.subtract(times_ns[1:], times_ns[:-1], out=steps_ns[1:])
        if steps_ns.min() < 0:
            raise DeviceError(f"torque: times go back before {last_ns} ns; give them in ascending order")
        state.last_ns = int(times_ns[-1])
        root_s = np.sqrt(steps_ns * 1e-9)
        bias = _walk(state.bias_n_m, self.bias_drift_n_m_per_sqrt_s, root_s, draws[:, 1])
        gain = _walk(state.gain, self.gain_drift_per_sqrt_s, root_s, draws[:, 2])
        state.bias_n_m, state.gain = float(bias[-1]), float(gain[-1])
        return bias, gain


def _walk(start: float, drift: float, root_s: Float64Array, draws: Float64Array) -> Float64Array:
    """Return a random walk after each step; summed from its start, so that blocks round as one sum does."""
    steps = np.empty(len(draws) + 1)
    steps[0] = start
    np.multiply(root_s, draws, out=steps[1:])
    steps[1:] *= drift
    return steps.cumsum()[1:]
