"""What the surface adds to the torque along a path: correlated over a length, the same for the same track."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Texture:
    """A stationary Gaussian field over the path, of covariance sd^2 k(|y - y'| / length)."""

    sd_n_m: float = 0.0  # Standard deviation of the torque that it adds
    length_m: float = 0.004  # Correlation length
    # k(x): `exponential`, exp(-x), rough; `matern`, (1 + sqrt(3) x) exp(-sqrt(3) x), which has a slope;
    # `gaussian`, exp(-x^2 / 2), smooth, as what a contact of some width feels
    form: str = "gaussian"

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise PerceptionError(f"no form of texture '{self.form}'; use one of {', '.join(FORMS)}")
        if not (0.0 <= self.sd_n_m < 1.0 and 0.0 < self.length_m < 10.0):
            raise PerceptionError(
                f"texture of {self.sd_n_m} N m over {self.length_m} m: spread 0 or more, length positive"
            )

    def covariance(self, at_m: Float64Array, other_m: Float64Array) -> Float64Array:
        """Return the covariance between places, N^2 m^2, shape (..., n, o), of (..., n) and (..., o)."""
        apart = np.abs(np.asarray(at_m)[..., :, None] - np.asarray(other_m)[..., None, :]) / self.length_m
        return np.asarray(self.sd_n_m**2 * FORMS[self.form](apart))


FORMS: dict[str, Callable[[Float64Array], Float64Array]] = {
    "exponential": lambda x: np.exp(-x),
    "matern": lambda x: (1.0 + 3**0.5 * x) * np.exp(-(3**0.5) * x),
    "gaussian": lambda x: np.exp(-0.5 * x * x),
}


def fit_texture(
    residual_n_m: Float64Array,
    slope: Float64Array,
    prior_sd: Float64Array,
    scatter: Float64Array,
    place_m: Float64Array,
) -> Texture:
    """Return the likeliest texture of training residuals (r, b), with the latents marginalised."""
    if residual_n_m.ndim != 2 or len(residual_n_m) < 2 or not np.isfinite(residual_n_m).all():
        raise PerceptionError("a texture takes two mountings at least, all of whose torques are numbers")
    scaled = slope * prior_sd
    known = scaled @ scaled.swapaxes(1, 2) + scatter
    scale = float(np.log(max(residual_n_m.std(), 1e-9)))
    step = float(np.abs(np.diff(place_m, axis=1)).mean())
    ends = [(np.log(1e-9), np.log(0.5)), (np.log(0.5 * step), np.log(np.ptp(place_m)))]
    best, least = Texture(), np.inf
    for form in FORMS:

        def cost(log_of: Float64Array, form: str = form) -> float:
            """Return minus the log density of the residuals, but for a constant."""
            sd, length = np.exp(log_of)
            field = Texture(float(sd), float(length), form)
            lower = np.linalg.cholesky(known + field.covariance(place_m, place_m))
            white = np.linalg.solve(lower, residual_n_m[..., None])
            return float(0.5 * (white**2).sum() + np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())

        for shift in (0.0, -2.0):
            for length in (1.0, 3.0):
                begun = [scale + shift, np.log(length * step)]
                found = scipy.optimize.minimize(cost, begun, bounds=ends, method="L-BFGS-B")
                if found.fun < least:
                    sd, long = np.exp(found.x)
                    best, least = Texture(float(sd), float(long), form), float(found.fun)
    return best
