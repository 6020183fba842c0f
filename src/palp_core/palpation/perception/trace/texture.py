"""What the surface adds to the torque along a path: correlated over a length, the same for the same track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Texture:
    """A stationary Gaussian field over the path: covariance sd^2 exp(-|y - y'| / length).

    Attributes:
        sd_n_m: Standard deviation of the torque that it adds.
        length_m: Correlation length.
        reversing: Share of its variance that turns its sign with the sweep's direction, as friction does; the
            rest is of the surface's form and pushes the same way in both.

    Raises:
        PerceptionError: A negative spread, no length, or a share outside 0 to 1.
    """

    sd_n_m: float = 0.0
    length_m: float = 0.004
    reversing: float = 0.5

    def __post_init__(self) -> None:
        if not (0.0 <= self.sd_n_m < 1.0 and 0.0 < self.length_m < 10.0 and 0.0 <= self.reversing <= 1.0):
            raise PerceptionError(
                f"texture of {self.sd_n_m} N m over {self.length_m} m, {self.reversing} reversing: spread "
                "0 or more, length positive, share 0 to 1"
            )

    def covariance(self, at_m: Float64Array, other_m: Float64Array, *, same_way: bool = True) -> Float64Array:
        """Return the covariance between places, N^2 m^2, shape (n, o), of torques against the sweep.

        Args:
            at_m: Places of one sweep, shape (n,).
            other_m: Places of another, or the same, shape (o,).
            same_way: Whether both go the same way.
        """
        apart = np.abs(np.asarray(at_m)[:, None] - np.asarray(other_m)[None, :])
        share = 1.0 if same_way else 2.0 * self.reversing - 1.0
        return np.asarray(share * self.sd_n_m**2 * np.exp(-apart / self.length_m))


def fit_texture(
    residual_n_m: Float64Array,
    slope: Float64Array,
    prior_sd: Float64Array,
    white_sd: float,
    place_m: Float64Array,
) -> Texture:
    """Return the texture that makes residuals of training likeliest, with what else they hold marginalised.

    Args:
        residual_n_m: Mean traces of mountings less what their class has in common, shape (r, b).
        slope: Change of each by a unit of each latent, shape (r, b, l).
        prior_sd: Spread of the latents in the residuals, shape (l,).
        white_sd: Of a bin of such a mean, N m.
        place_m: Where the bins are, shape (b,).

    Raises:
        PerceptionError: Fewer than two residuals, or they are not finite.
    """
    if residual_n_m.ndim != 2 or len(residual_n_m) < 2 or not np.isfinite(residual_n_m).all():
        raise PerceptionError("a texture takes two mountings at least, all of whose torques are numbers")
    known = [(s * prior_sd) @ (s * prior_sd).T + white_sd**2 * np.eye(len(place_m)) for s in slope]

    def cost(log_of: Float64Array) -> float:
        field = Texture(float(np.exp(log_of[0])), float(np.exp(log_of[1])), 0.5).covariance(place_m, place_m)
        total = 0.0
        for row, covariance in zip(residual_n_m, known, strict=True):
            lower = np.linalg.cholesky(covariance + field)
            white = scipy.linalg.solve_triangular(lower, row, lower=True)
            total += 0.5 * float(white @ white) + float(np.log(np.diag(lower)).sum())
        return total

    scale = float(np.log(max(residual_n_m.std(), white_sd, 1e-9)))
    step = float(np.abs(np.diff(place_m)).mean())
    ends = [(np.log(1e-9), np.log(0.5)), (np.log(0.5 * step), np.log(np.ptp(place_m)))]
    found = min(
        (
            scipy.optimize.minimize(
                cost, [scale + shift, np.log(length * step)], bounds=ends, method="L-BFGS-B"
            )
            for shift in (0.0, -2.0)
            for length in (1.0, 5.0)
        ),
        key=lambda result: float(result.fun),
    )
    return Texture(float(np.exp(found.x[0])), float(np.exp(found.x[1])), 0.5)
