"""Memory primitives: what training showed, P(reading | class, setting), for any number of both.

In the experiment a class is a nodule's depth, a setting is a ring position r_a, and a reading is a peak
torque. The functions ask for nothing of that kind: readings, means and deviations share one unit, whichever
it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.palpation.perception.belief.likelihoods import Cells
from palp_core.units import Float64Array


def quantisation_sd(resolution: float) -> float:
    """Return the standard deviation of rounding to steps of ``resolution``: resolution / sqrt(12)."""
    return float(resolution / np.sqrt(12.0))


@dataclass(frozen=True, eq=False)
class Primitives:
    """A normal per class and setting.

    Attributes:
        depths_m: Value of each class, strictly increasing, shape (m,).
        rings_m: Value of each setting, shape (k,).
        mean: Mean reading, shape (m, k).
        sd: Standard deviation, at least ``floor``, shape (m, k).
        count: Number of training readings, shape (m, k).
        floor: Smallest standard deviation the sensor can show, in the reading's unit.
    """

    depths_m: Float64Array
    rings_m: Float64Array
    mean: Float64Array
    sd: Float64Array
    count: Float64Array
    floor: float

    def __post_init__(self) -> None:
        for name in ("depths_m", "rings_m", "mean", "sd", "count"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        shape = (self.depths_m.size, self.rings_m.size)
        for name in ("mean", "sd", "count"):
            array = getattr(self, name)
            if array.shape != shape:
                raise PerceptionError(
                    f"primitives: {name} has shape {array.shape}, not {shape} (classes, settings)"
                )
            if not np.isfinite(array).all():
                raise PerceptionError(f"primitives: {name} holds NaN or infinity; train every cell")
        if not self.floor > 0.0 or (self.sd < self.floor).any():
            raise PerceptionError("primitives: the floor must be positive and no sd below it")
        if (np.diff(self.depths_m) <= 0.0).any():
            raise PerceptionError("primitives: depths_m must increase")
        if (self.count < 1).any():
            raise PerceptionError("primitives: every cell needs at least one reading")

    def log_likelihood(self, reading: float, setting_index: int, *, model: str = "normal") -> Float64Array:
        """Return log P(reading | class, setting) for every class, shape (m,).

        Args:
            reading: The new reading, in the unit of the training readings.
            setting_index: Which setting it was taken at.
            model: A method of task ``likelihood``: ``normal`` or ``student_t``.

        Raises:
            PerceptionError: The reading is not finite or the setting was not trained.
            MethodError: No such model.
        """
        density: Float64Array = find("likelihood", model).target(reading, self._cells(reading, setting_index))
        return density

    def is_outlier(self, reading: float, setting_index: int, *, z_limit: float = 5.0) -> bool:
        """Return whether the reading is more than ``z_limit`` deviations (assumed: 5) from every class.

        The likelihood stays finite then, but its choice of class is an extrapolation of the normal's tail.
        """
        cells = self._cells(reading, setting_index)
        return bool(np.min(np.abs(reading - cells.mean) / cells.sd) > z_limit)

    def _cells(self, reading: float, setting_index: int) -> Cells:
        if not np.isfinite(reading):
            raise PerceptionError(f"reading is {reading}; drop the probe")
        if not 0 <= setting_index < self.rings_m.size:
            raise PerceptionError(f"setting {setting_index} was not trained; there are {self.rings_m.size}")
        k = setting_index
        return Cells(self.mean[:, k], self.sd[:, k], self.count[:, k], self.floor)

    def interpolated(self, depths_m: Float64Array) -> Primitives:
        """Return primitives on another depth grid inside the trained one.

        Mean and log sd follow a monotone cubic over depth (no overshoot); a new cell counts as its poorer
        neighbour.

        Raises:
            PerceptionError: A depth lies outside the trained range, or only one was trained.
        """
        grid = np.asarray(depths_m, dtype=np.float64)
        if self.depths_m.size < 2 or grid.min() < self.depths_m[0] or grid.max() > self.depths_m[-1]:
            raise PerceptionError(
                f"primitives know {self.depths_m[0]} to {self.depths_m[-1]} m and do not extrapolate"
            )
        above = np.clip(np.searchsorted(self.depths_m, grid), 1, self.depths_m.size - 1)
        log_sd = scipy.interpolate.PchipInterpolator(self.depths_m, np.log(self.sd))(grid)
        return Primitives(
            depths_m=grid,
            rings_m=self.rings_m,
            mean=scipy.interpolate.PchipInterpolator(self.depths_m, self.mean)(grid),
            sd=np.maximum(np.exp(log_sd), self.floor),
            count=np.minimum(self.count[above - 1], self.count[above]),
            floor=self.floor,
        )

    @classmethod
    def from_rows(cls, flat: Mapping[str, Sequence[float]]) -> Primitives:
        """Return the primitives of the fields as flat lists, row by row, as messages and states hold them.

        Raises:
            PerceptionError: A list is too short, or the values do not fit together.
        """
        shape = (len(flat["depths_m"]), len(flat["rings_m"]))
        cells = {name: np.array(flat[name], dtype=np.float64) for name in ("mean", "sd", "count")}
        if any(values.size != shape[0] * shape[1] for values in cells.values()):
            raise PerceptionError(f"primitives: there are not {shape} values of mean, sd and count")
        return cls(
            depths_m=np.array(flat["depths_m"]),
            rings_m=np.array(flat["rings_m"]),
            floor=flat["floor"][0],
            **{name: values.reshape(shape) for name, values in cells.items()},
        )

    @classmethod
    def from_json_dict(cls, data: Mapping[str, Any]) -> Primitives:
        """Return the primitives of the fields as nested lists; JSON keeps every bit of them.

        Raises:
            PerceptionError: A key is missing or unknown, or the values do not fit together.
        """
        expected = {one.name for one in fields(cls)}
        if set(data) != expected:
            raise PerceptionError(f"primitives have the keys {sorted(expected)}, not {sorted(data)}")
        return cls(**data)


def fit_cells(readings: Sequence[tuple[float, float, float]], floor: float) -> Primitives:
    """Fit as :func:`fit` does, to readings as (depth in m, ring in m, value); errors as there."""
    depths_m = sorted({depth_m for depth_m, _, _ in readings})
    rings_m = sorted({ring_m for _, ring_m, _ in readings})
    return fit(
        np.array([value for _, _, value in readings]),
        [depths_m.index(depth_m) for depth_m, _, _ in readings],
        [rings_m.index(ring_m) for _, ring_m, _ in readings],
        depths_m=depths_m,
        rings_m=rings_m,
        floor=floor,
    )


def fit(
    readings: Float64Array,
    class_index: Sequence[int],
    setting_index: Sequence[int],
    *,
    depths_m: Sequence[float],
    rings_m: Sequence[float],
    floor: float,
) -> Primitives:
    """Fit a normal (mean, unbiased sd) to the readings of every cell."""
    values = np.asarray(readings, dtype=np.float64)
    classes, settings = np.asarray(class_index, dtype=np.int64), np.asarray(setting_index, dtype=np.int64)
    if values.ndim != 1 or values.shape != classes.shape or values.shape != settings.shape:
        raise PerceptionError("training: readings, class_index and setting_index must be equally long")
    if not np.isfinite(values).all():
        raise PerceptionError("training: a reading is NaN or infinite; drop that palpation")
    shape = (len(depths_m), len(rings_m))
    if values.size and not (
        0 <= classes.min() <= classes.max() < shape[0] and 0 <= settings.min() <= settings.max() < shape[1]
    ):
        raise PerceptionError(f"training: an index lies outside {shape} (classes, settings)")
    cell = classes * shape[1] + settings
    count = np.bincount(cell, minlength=shape[0] * shape[1]).astype(np.float64)
    if (count == 0).any():
        missing = [
            (depths_m[c // shape[1]], rings_m[c % shape[1]]) for c in np.flatnonzero(count == 0).tolist()
        ]
        raise PerceptionError(
            f"training: no reading for (depth, ring) in m: {missing}; palpate there or leave it out"
        )
    mean = np.bincount(cell, weights=values, minlength=count.size) / count
    squares = np.bincount(cell, weights=(values - mean[cell]) ** 2, minlength=count.size)
    sd = np.maximum(np.sqrt(squares / np.maximum(count - 1.0, 1.0)), floor)
    return Primitives(
        np.array(depths_m),
        np.array(rings_m),
        mean.reshape(shape),
        sd.reshape(shape),
        count.reshape(shape),
        floor,
    )
