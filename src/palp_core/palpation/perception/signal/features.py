"""One number from a de-noised sweep: the peak over the nodule, or how far it rises above its surroundings."""

from dataclasses import dataclass

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Peak:
    """The largest torque of a sweep and the sample at which it occurs."""

    value_n_m: float
    index: int


@dataclass(frozen=True)
class Contrast:
    """Peak minus local base, and the peak's sample."""

    value_n_m: float
    index: int


def _search_range(sample_count: int, edge: int, around: tuple[int, int] | None) -> tuple[int, int]:
    """Return the half-open range that is free of the boundary and, where given, near the nodule."""
    low, high = (0, sample_count) if around is None else around
    first, last = max(low, edge), min(high, sample_count - edge)
    if edge < 0 or first >= last:
        raise PerceptionError(
            f"no sample of {sample_count} lies in {around or 'the sweep'} and {edge} or more from both ends; "
            "sweep further past the nodule or lower the wavelet level"
        )
    return first, last


def peak(torque_n_m: Float64Array, *, edge: int, around: tuple[int, int] | None = None) -> Peak:
    """Return the maximum around the nodule.

    Args:
        torque_n_m: De-noised sweep, N m, shape (n,).
        edge: Samples at each end that depend on the boundary
            (:func:`palp_core.palpation.perception.signal.wavelet.edge_cone`); never searched.
        around: Half-open range of samples over the nodule; the whole sweep where its place is not known.

    Raises:
        PerceptionError: Nothing is left to search.
    """
    first, last = _search_range(len(torque_n_m), edge, around)
    index = first + int(np.argmax(torque_n_m[first:last]))
    return Peak(float(torque_n_m[index]), index)


def contrast(
    torque_n_m: Float64Array,
    *,
    edge: int,
    around: tuple[int, int] | None = None,
    reach: int = 600,
    flank: int = 100,
) -> Contrast:
    """Return the peak minus the mean of the medians of the two flanks next to it.

    A flank that would fall into the boundary is left out; the other then is the base alone.

    Args:
        torque_n_m: De-noised sweep, N m, shape (n,).
        edge: As for :func:`peak`.
        around: As for :func:`peak`.
        reach: Samples from the peak to the near side of a flank. Assumed: 600 is 12 mm at 20 mm/s and 1 kHz,
            beyond a 15 mm nodule's 7.5 mm.
        flank: Samples in a flank (assumed).

    Raises:
        PerceptionError: Nothing is left to search, or neither flank lies inside the sweep.
    """
    found = peak(torque_n_m, edge=edge, around=around)
    starts = (found.index - reach - flank + 1, found.index + reach)
    inside = [s for s in starts if s >= edge and s + flank <= len(torque_n_m) - edge]
    if not inside or flank < 1:
        raise PerceptionError(
            f"no flank of {flank} samples at {reach} from the peak at {found.index} of {len(torque_n_m)} "
            "lies inside the sweep; shorten `reach` or sweep further past the nodule"
        )
    base = float(np.mean([np.median(torque_n_m[s : s + flank]) for s in inside]))
    return Contrast(found.value_n_m - base, found.index)
