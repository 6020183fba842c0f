"""What outlives the driver of a force and torque sensor, and how a block is made of its wrenches."""

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
    wrench: Float64Array,
    saturated: BoolArray,
    faulty: BoolArray,
    clock: ClockFit,
) -> TorqueSamples:
    """Return a block: bias subtracted, the torque about one axis clipped to the range where saturated."""
    wrench = wrench - np.array(state.bias)
    torque_n_m = sign * wrench[:, _COLUMNS[axis]]
    limited = np.where(saturated, np.clip(torque_n_m, -range_n_m, range_n_m), torque_n_m)
    if len(index):
        state.sample_count = int(index[-1]) + 1
    return TorqueSamples(
        times_ns, limited, int(np.count_nonzero(saturated)), index, gap, saturated | faulty, wrench, clock
    )


def bias_from(block: TorqueSamples, state: WrenchState) -> Float64Array:
    """Make the mean of a block, read unloaded, the new zero of forces and torques; return it, shape (6,).

    Raises:
        DeviceError: The block is empty or has samples that must not be used.
    """
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
