"""What a reading of several columns is expected to tell about the class, per setting.

Of one column it is :func:`palp_core.palpation.perception.belief.information.expected_gains_bits`; of several
the integral over readings is a sum over points of a Sobol sequence, the same for every belief.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.palpation.perception.belief.information import expected_gains_bits
from palp_core.palpation.perception.belief.vector_primitives import VectorPrimitives
from palp_core.units import Float64Array

_POINTS = 256  # per class: within 0.02 bit of 2^14 points for two to four columns, which ranks settings


@dataclass(frozen=True, eq=False)
class ExpectedGain:
    """The mutual information of class and next reading under normal cells.

    Attributes:
        primitives: What training taught.
        settings: Indices of the settings that can be asked for, each felt with every class, length j.
        ratio: Density of each class over that of the reading's own, shape (j, m, q, m): settings, own class,
            points, classes; empty where readings have one column.
    """

    primitives: VectorPrimitives
    settings: tuple[int, ...]
    ratio: Float64Array

    @classmethod
    def of(cls, primitives: VectorPrimitives, settings: tuple[int, ...]) -> "ExpectedGain":
        """Return the gains of primitives."""
        if primitives.floor.size == 1:
            return cls(primitives, settings, np.zeros((0, 0, 0, 0)))
        points = _normal_points(primitives.floor.size)
        return cls(primitives, settings, np.stack([_ratios(primitives, k, points) for k in settings]))

    def bits(self, posterior: Float64Array) -> Float64Array:
        """Return the expected gain in bits of each setting under a belief (m,), shape (j,)."""
        if not self.ratio.size:
            at = list(self.settings)
            mean, var = self.primitives.mean[:, at, 0].T, self.primitives.cov[:, at, 0, 0].T
            return expected_gains_bits(posterior, mean, np.sqrt(var))
        mixture = np.maximum(self.ratio @ posterior, np.finfo(np.float64).tiny)  # where the own class is at 0
        each = -np.log2(mixture).mean(axis=-1)  # (j, m)
        return np.asarray(np.maximum(each @ posterior, 0.0))


def _normal_points(columns: int) -> Float64Array:
    """Return points of the standard normal in so many dimensions, shape (q, f)."""
    uniform = scipy.stats.qmc.Sobol(columns, rng=np.random.default_rng(0)).random(_POINTS)
    return np.asarray(scipy.special.ndtri(np.clip(uniform, 1e-9, 1.0 - 1e-9)))


def _ratios(primitives: VectorPrimitives, setting: int, points: Float64Array) -> Float64Array:
    """Return the density of every class over a class's own, at points of the latter, shape (m, q, m)."""
    mean, root = primitives.mean[:, setting], np.linalg.cholesky(primitives.cov[:, setting])
    at = mean[:, None] + points @ np.swapaxes(root, -1, -2)  # (m, q, f)
    log_density = primitives.log_likelihood(at.reshape(-1, at.shape[-1]), setting)
    log_density = log_density.reshape(*at.shape[:2], -1)
    own: NDArray[np.int64] = np.arange(len(mean))
    return np.exp(np.clip(log_density - log_density[own, :, own][..., None], None, 700.0))
