"""The noise file of a rig, which ``plan:=repeatability`` writes, and simulation and filter load.

::

    sample_sd_n_m: {value: 1.6e-05, low: 1.5e-05, high: 1.6e-05}
    sweep_sd_n_m: {value: 2.0e-06, low: 1.6e-06, high: 2.5e-06}
    ring_sd_m: {value: 0.00017, low: 0.00013, high: 0.00022}
    height_sd_m: {value: 0.0001}
    hour_sd_n_m: {value: 0.0}
    basis: repeatability of 2026-11-21, 16 mountings
"""

import math
from pathlib import Path

import msgspec
import numpy as np
import scipy

from palp_core.errors import PerceptionError, in_words
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.units import Float64Array
from palp_core.whole_file import read_whole, why_not, write_whole

_LARGEST_BYTES = 256 << 10
_LARGEST_HEIGHT_SD_M = 0.1  # beyond it no phantom lies under the probe
_CHANCE = 0.999  # of a cell's variance: what is above it was no chance


class Component(msgspec.Struct, frozen=True, omit_defaults=True):
    """A standard deviation, with the ends of its interval where it was measured."""

    value: float
    low: float | None = None
    high: float | None = None


class RigNoise(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations of what differs between palpations.

    Attributes:
        sample_sd_n_m: Of a torque sample about the true torque, within a sweep.
        sweep_sd_n_m: Of the reading between two sweeps when nothing was moved.
        ring_sd_m: Of the ring's landing about its target; it stays until the ring moves.
        height_sd_m: Of the phantom's surface over mountings; it stays until the next.
        hour_sd_n_m: Of the reading's change within an hour when nothing was moved.
        basis: Where the numbers come from.
    """

    sample_sd_n_m: Component
    sweep_sd_n_m: Component
    ring_sd_m: Component
    height_sd_m: Component
    hour_sd_n_m: Component = Component(0.0)
    basis: str = ""


def read_noise(path: str | Path) -> RigNoise:
    """Return the noise of a file.

    Raises:
        PerceptionError: No such file, an unknown or missing key, or a negative number.
    """
    try:
        found = msgspec.yaml.decode(read_whole(path, _LARGEST_BYTES), type=RigNoise)
    except OSError as error:
        raise PerceptionError(f"{path}: cannot read the noise file: {why_not(error, path)}") from error
    except msgspec.MsgspecError as error:
        raise PerceptionError(
            f"{path}: no noise file: {in_words(error)}; "
            "palp launch FILE plan:=repeatability writes OUT/noise.yaml"
        ) from error
    for name in ("sample_sd_n_m", "sweep_sd_n_m", "ring_sd_m", "height_sd_m", "hour_sd_n_m"):
        value = getattr(found, name).value
        most = _LARGEST_HEIGHT_SD_M if name == "height_sd_m" else 1.0
        if not (math.isfinite(value) and 0.0 <= value <= most):
            raise PerceptionError(
                f"{path}: {name} is {value}; a standard deviation in SI lies in 0 to {most:g}"
            )
    return found


def write_noise(noise: RigNoise, path: Path) -> None:
    """Write a file; it appears under its name only when complete."""
    write_whole(path, msgspec.yaml.encode(noise))


def assumed_noise(ring_sd_m: float, height_sd_m: float) -> RigNoise:
    """Return the noise of a rig that was not measured: what is assumed of landing and height, no more."""
    if not (ring_sd_m >= 0.0 and height_sd_m >= 0.0):
        raise PerceptionError(f"ring {ring_sd_m} m, height {height_sd_m} m: a spread is 0 or more")
    none = Component(0.0)
    return RigNoise(
        sample_sd_n_m=none,
        sweep_sd_n_m=none,
        ring_sd_m=Component(ring_sd_m),
        height_sd_m=Component(height_sd_m),
        basis="assumed",
    )


def noise_of(path: str, ring_sd_m: float, height_sd_m: float) -> RigNoise:
    """Return the noise of a file, or without one (an empty path) what is assumed; errors as of both."""
    return read_noise(path) if path else assumed_noise(ring_sd_m, height_sd_m)


def on_depths(values: Float64Array, depths_m: Float64Array, grid_m: Float64Array) -> Float64Array:
    """Return values of trained depths, shape (m, ...), on others between them, by a monotone cubic."""
    if depths_m.size == grid_m.size:
        return values
    return np.asarray(scipy.interpolate.PchipInterpolator(depths_m, values)(grid_m))


def independent_model(primitives: Primitives) -> OffsetModel:
    """Return the paper's reading of the primitives: every reading is independent, eq. (7)."""
    mean = primitives.mean[..., None]
    nothing = np.zeros((*mean.shape, 0))
    return OffsetModel(mean, (primitives.sd**2)[..., None, None], nothing, np.zeros(0), ())


def latent_model(primitives: Primitives, noise: RigNoise, height_slope: Float64Array) -> OffsetModel:
    """Return the model of readings that share the ring's landing and the phantom's height.

    How a reading answers to the ring is taken from the primitives' own means over the rings. What training
    scattered beyond the ring's part is drawn again at every reading, at least ``sweep_sd_n_m``: one variance
    for all cells, and in a cell that scattered more than chance makes of it (99.9 %) the excess too. The
    height counts against that of the training's mounting, hence its variance twice.
    """
    mean = primitives.mean
    if height_slope.shape != mean.shape:
        raise PerceptionError(f"height_slope has shape {height_slope.shape}, not {mean.shape}")
    ring_slope = ring_slopes(mean, primitives.rings_m)
    least = max(noise.sweep_sd_n_m.value, primitives.floor) ** 2
    own = _own_variance(primitives, (ring_slope * noise.ring_sd_m.value) ** 2, least)
    return OffsetModel(
        mean[..., None],
        own[..., None, None],
        np.stack([ring_slope, height_slope], axis=-1)[:, :, None, :],
        np.array([noise.ring_sd_m.value, np.sqrt(2.0) * noise.height_sd_m.value]),
        (True, False),
    )


def _own_variance(primitives: Primitives, ring_variance: Float64Array, least: float) -> Float64Array:
    """Return the variance that is drawn again at every reading, shape (m, k).

    What a single cell scattered minus the ring's part is mostly chance where that part is large: taken cell
    by cell, a class that came out near zero would be trusted for it. So it is one number, the median over the
    cells weighted by the inverse variance of each one's estimate, 2 / f (ring + own)^2.
    """
    freedom = np.maximum(primitives.count - 1.0, 1.0)
    beyond, weight = primitives.sd**2 - ring_variance, freedom / (ring_variance + least) ** 2
    order = np.argsort(beyond, axis=None)
    gathered = np.cumsum(weight.ravel()[order])
    own = max(float(beyond.ravel()[order][np.searchsorted(gathered, 0.5 * gathered[-1])]), least)
    by_chance = scipy.stats.chi2.ppf(_CHANCE, freedom) / freedom * (ring_variance + own)
    return np.asarray(own + np.maximum(primitives.sd**2 - by_chance, 0.0))


def ring_slopes(mean: Float64Array, rings_m: Float64Array) -> Float64Array:
    """Return the change of the reading per metre of ring, from the means over ring positions.

    A monotone cubic through the means, so no slope is steeper than its neighbours allow.

    Returns:
        Slopes, reading's unit per metre, shape (m, k).
    """
    if len(rings_m) < 2:
        raise PerceptionError("a slope over ring positions needs two of them; train more, or take no offset")
    return np.asarray(scipy.interpolate.PchipInterpolator(rings_m, mean, axis=1).derivative()(rings_m))
