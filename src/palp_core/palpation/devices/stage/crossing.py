"""When the stage passed a place, from polls of its position."""

from __future__ import annotations

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import Int64Array
from palp_core.units import Float64Array


def crossing_ns(times_ns: Int64Array, place_m: Float64Array, wanted_m: float) -> int:
    """Return when a place was passed, linear between two samples; the last time if it was passed often.

    Args:
        times_ns: Times, shape (n,).
        place_m: Positions at them, shape (n,).
        wanted_m: The place.

    Raises:
        DeviceError: It was never passed.
    """
    beyond = place_m > wanted_m
    passes = np.flatnonzero(beyond[1:] != beyond[:-1])
    if not len(passes):
        raise DeviceError(f"stage: it never passed {wanted_m * 1e3:g} mm; see its positions")
    k = int(passes[-1])
    share = (wanted_m - place_m[k]) / (place_m[k + 1] - place_m[k])
    return int(times_ns[k]) + round(float(share) * int(times_ns[k + 1] - times_ns[k]))
