"""Sweeps gathered into cells of one mounting and one ring position: what a phantom is fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.perception.signal.smoothers import SavitzkyGolay
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from palp_core.units import Float64Array

_SMOOTH = SavitzkyGolay(50, 3)
_NOISE_GAIN = 0.15  # of that window and degree: the root sum of its squared weights at the middle
_POINT_STEP_M = 0.002
_LEAST_RING_M = 1e-3  # without the springs there is next to no torque, and its sign is the ring's error's
_TOGETHER = ("stay", "remount", "hour")  # conditions in which the ring stays where it is


@dataclass(frozen=True, eq=False)
class MeanSweep:
    """The mean sweep of one mounting at one ring position, over a bead up to its peak.

    Behind the peak the tip can snap off the bead, a little elsewhere in every sweep, and a mean of that is no
    sweep.

    Attributes:
        mount: Number of the mounting, over all sessions.
        depth_m: Bead's depth; 0 for bare gel.
        ring_m: Ring as commanded.
        landing_count: Positionings of the ring behind the mean.
        stage_m: Stage positions, shape (p,).
        torque_n_m: Mean torque there, shape (p,).
        sd_n_m: Standard deviation of each point by the sensor's noise alone.
        peaks_n_m: Largest smoothed torque of each sweep.
    """

    mount: int
    depth_m: float
    ring_m: float
    landing_count: int
    stage_m: Float64Array
    torque_n_m: Float64Array
    sd_n_m: float
    peaks_n_m: Float64Array


def gather(
    sessions: Sequence[RecordedSweeps], *, from_m: float, speed_m_s: float, sample_sd_n_m: float
) -> list[MeanSweep]:
    """Return the cells of every sweep whose phantom is known: training, and the plan ``repeatability``.

    Args:
        sessions: Stored sweeps.
        from_m: Stage position at the first sample.
        speed_m_s: Speed of the stage; negative for a sweep towards -Y.
        sample_sd_n_m: Noise of a sample, the rounding included.

    Raises:
        PalpError: No sweep's phantom is known, or sweeps of a cell differ in length.
    """
    grouped: dict[tuple[int, int, float, float], list[RecordedSweep]] = {}
    for number, session in enumerate(sessions):
        for sweep in session.sweeps:
            if sweep.phase != "estimation" and sweep.depth_m is not None and sweep.ring_m >= _LEAST_RING_M:
                key = (number, sweep.remount, sweep.depth_m, sweep.ring_m)
                grouped.setdefault(key, []).append(sweep)
    if not grouped:
        raise PalpError("no sweep is of a known phantom; palp phantom fit needs training or bare-gel sweeps")
    mounts = {pair: i for i, pair in enumerate(sorted({(n, remount) for n, remount, _, _ in grouped}))}
    return [
        _cell(mounts[n, remount], depth_m, ring_m, sweeps, from_m, speed_m_s, sample_sd_n_m)
        for (n, remount, depth_m, ring_m), sweeps in sorted(grouped.items())
    ]


def _cell(
    mount: int,
    depth_m: float,
    ring_m: float,
    sweeps: Sequence[RecordedSweep],
    from_m: float,
    speed_m_s: float,
    sample_sd_n_m: float,
) -> MeanSweep:
    shapes = {(sweep.torque_n_m.size, sweep.rate_hz) for sweep in sweeps}
    if len(shapes) != 1:
        raise PalpError(f"sweeps at ring {ring_m * 1e3:g} mm differ in length or rate: {sorted(shapes)}")
    ((count, rate_hz),) = shapes
    smooth = np.array([_SMOOTH.apply(sweep.torque_n_m) for sweep in sweeps])
    edge = _SMOOTH.edge
    step = max(1, round(_POINT_STEP_M * rate_hz / abs(speed_m_s)))
    mean = np.asarray(smooth.mean(axis=0), dtype=np.float64)
    last = edge + int(np.argmax(mean[edge : count - edge])) if depth_m > 0.0 else count - edge
    points = np.arange(edge, max(last, count // 2), step)
    landings = {(s.phase, 0 if s.phase in _TOGETHER else s.trial) for s in sweeps}
    return MeanSweep(
        mount,
        depth_m,
        ring_m,
        len(landings),
        np.asarray(from_m + points * (speed_m_s / rate_hz), dtype=np.float64),
        mean[points],
        _NOISE_GAIN * sample_sd_n_m / float(np.sqrt(len(sweeps))),
        smooth[:, edge : count - edge].max(axis=1),
    )
