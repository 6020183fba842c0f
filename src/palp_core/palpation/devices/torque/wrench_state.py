"""What outlives the driver of a force and torque sensor, and how a block is made of its wrenches."""

from collections.abc import Sequence

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import BoolArray, ClockFit, Int64Array, TorqueSamples
from palp_core.units import Float64Array

_COLUMNS = {"x": 3, "y": 4, "z": 5}


class WrenchState(msgspec.Struct):
    """Bias and count, kept by the caller with the data.

    Attributes:
        bias: What is subtracted, forces in N and torques in N m.
        sample_count: Samples numbered so far.
    """

    bias: list[float] = msgspec.field(default_factory=lambda: [0.0] * 6)
    sample_count: int = 0


def torque_block(
    axis: str,
    sign: int,
    range_n_m: float,
    state: WrenchState,
    times_ns: Int64Array,
    index: Int64Array,
    gap: BoolArray,
    wrench: Sequence[Sequence[float]],
    saturated: Sequence[bool],
    faulty: Sequence[bool],
    clock: ClockFit,
) -> TorqueSamples:
    """Return a block: bias subtracted, the torque about one axis clipped to the range where saturated.

    Of the one or two samples of a millisecond plain numbers take a tenth of what arrays take, hence rows.
    """
    column, bias = _COLUMNS[axis], state.bias
    wrench = [[load - zero for load, zero in zip(row, bias, strict=True)] for row in wrench]
    torque_n_m = [sign * row[column] for row in wrench]
    if any(saturated):
        torque_n_m = [
            min(max(torque, -range_n_m), range_n_m) if over else torque
            for torque, over in zip(torque_n_m, saturated, strict=True)
        ]
    if len(index):
        state.sample_count = int(index[-1]) + 1
    return TorqueSamples(
        times_ns,
        np.array(torque_n_m, np.float64),
        sum(saturated),
        index,
        gap,
        np.array([over or bad for over, bad in zip(saturated, faulty, strict=True)], np.bool_),
        np.array(wrench, np.float64).reshape(-1, 6),
        clock,
    )


def bias_from(block: TorqueSamples, state: WrenchState) -> Float64Array:
    """Make the mean of a block, read unloaded, the new zero of forces and torques; return it, shape (6,)."""
    if not len(block.wrench) or bool(np.any(block.faulty)):
        raise DeviceError(
            "torque: cannot tare from an empty or faulty block; unload the probe and read again"
        )
    bias: Float64Array = np.array(state.bias) + block.wrench.mean(axis=0)
    state.bias = bias.tolist()
    return bias


def check_axis(axis: str, sign: int) -> None:
    """Refuse an axis that is none of x, y, z, or a sign that is not +-1."""
    if axis not in _COLUMNS or sign not in (1, -1):
        raise DeviceError(f"torque: axis '{axis}', sign {sign}; give x, y or z, and +1 or -1")
