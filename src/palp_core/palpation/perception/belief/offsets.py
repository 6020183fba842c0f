"""What is known to stay, from memory primitives: how a reading answers to the landing of the ring."""

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


def ring_slopes(mean: Float64Array, rings_m: Float64Array) -> Float64Array:
    """Return the change of the reading per metre of ring, from the means over ring positions.

    A monotone cubic through the means, so no slope is steeper than its neighbours allow.

    Args:
        mean: Mean reading, shape (m, k).
        rings_m: Ring positions, increasing, shape (k,).

    Returns:
        Slopes, reading's unit per metre, shape (m, k).

    Raises:
        PerceptionError: There are fewer than two ring positions.
    """
    if len(rings_m) < 2:
        raise PerceptionError("a slope over ring positions needs two of them; train more, or take no offset")
    return np.asarray(scipy.interpolate.PchipInterpolator(rings_m, mean, axis=1).derivative()(rings_m))
