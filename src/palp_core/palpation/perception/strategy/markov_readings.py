"""What a chain does under each of the three readings of eqs. (4) and (5), and which of them freezes.

The equations carry a distribution on, P_{S,t+1} = M P_{S,t}, yet reset it to a normal of fixed width about
its mean after every step, and do not say what chooses the level. ``column`` draws from M[:, current];
``gaussian_reset`` carries the mean and draws from the normal; ``mean`` carries the mean and draws nothing.
The stepping itself is :class:`palp_core.palpation.perception.strategy.policies.MarkovPolicy`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.markov import stationary
from palp_core.palpation.perception.strategy.policies import MarkovPolicy
from palp_core.units import Float64Array

Reading = Literal["column", "gaussian_reset", "mean"]
READINGS: tuple[Reading, ...] = ("column", "gaussian_reset", "mean")

_MOST_STEPS = 10_000


@dataclass(frozen=True)
class LongRun:
    """Where a reading ends.

    Attributes:
        reading: Its name.
        law: Share of each level in the long run.
        mean_level: Mean of P_S there, dimensionless.
        frozen_after: Steps after which the level never changes again; None where it goes on changing.
    """

    reading: Reading
    law: tuple[float, ...]
    mean_level: float
    frozen_after: int | None


def long_run(
    matrix: Float64Array, reading: Reading, *, levels: Sequence[float], mean_level: float, sd_level: float
) -> LongRun:
    """Return where a chain ends under a reading.

    Args:
        matrix: M[next, current], column-stochastic, shape (n, n).
        reading: Which of the three.
        levels: Co-contraction of each level, shape (n,).
        mean_level: Mean of P_{S,1}.
        sd_level: sigma_S.

    Raises:
        PerceptionError: The chain is reducible (``column``), or the mean does not settle.
    """
    scale = np.asarray(levels, dtype=np.float64)
    if reading == "column":
        law = stationary(matrix)
        return LongRun(reading, tuple(law.tolist()), float(scale @ law), None)
    rings_m = tuple(float(i) for i in range(len(scale)))  # where the ring stands does not matter here
    chain = MarkovPolicy(
        np.asarray(matrix)[None], reading, rings_m=rings_m, levels=tuple(scale.tolist()), sd_level=sd_level
    )
    means = [mean_level]
    while len(means) < 2 or abs(means[-1] - means[-2]) > 1e-13:
        if len(means) > _MOST_STEPS:
            raise PerceptionError(f"the mean of reading '{reading}' does not settle in {_MOST_STEPS} steps")
        means.append(float(scale @ (matrix @ chain.level_law(means[-1]))))
    if reading == "gaussian_reset":
        return LongRun(reading, tuple(chain.level_law(means[-1]).tolist()), means[-1], None)
    visited = [int(np.argmin(np.abs(scale - mean))) for mean in means]
    frozen = max((t + 1 for t, level in enumerate(visited) if level != visited[-1]), default=0)
    law = np.zeros(len(scale))
    law[visited[-1]] = 1.0
    return LongRun(reading, tuple(law.tolist()), means[-1], frozen)
