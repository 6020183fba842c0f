"""What varies on a simulated rig, and how an experiment is run on it."""

from dataclasses import dataclass
from typing import get_args

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.session.orders import BLOCKS, GROUPED, MOUNTINGS
from palp_core.palpation.session.plan import Specimens
from palp_core.units import Float64Array

_SPREAD = {"uniform": 1 / np.sqrt(3.0), "normal": 0.5, "triangular": 1 / np.sqrt(6.0), "two_sided": 1.0}
"""Standard deviation of a landing in units of the repeatability."""


@dataclass(frozen=True)
class Conditions:
    """What varies on the rig, and how an experiment is run on it.

    Attributes:
        repeatability_m: The ring's +-0.3 mm (data sheet).
        distribution: ``uniform`` reads it as hard limits, ``triangular`` too, with landings near the middle
            more often; ``two_sided`` lands at either limit, as play does; ``normal`` is a band of 95 %.
        height_sd_m: Spread of the surface's height over mountings (assumed).
        training: Palpations per depth and ring position; 25 as published.
        training_lands: ``each`` palpation of training lands anew, or once a ``cell`` of depth and ring
            (blocked, not re-homed). Not published.
        mounting: Of a launch file: ``grouped`` mounts each phantom once a phase, ``each_trial`` for every
            trial, ``block_randomised`` also for every round of the ring positions in training.
        specimens: Of a launch file: trials are of the ``same`` phantoms as training, or of ``other`` ones.
        phantoms: Phantoms per depth, in turn in training and in estimation; 1 as published, so that a depth
            cannot be told from its phantom.
        trials: Trials per depth; 100 as published.
        rehome: Whether the ring is re-homed before each trial. If not, a fixed ring keeps one landing for all
            trials; a policy that moves it lands again in each. Not published.
        drift_n_m: Spread of a bias that comes between training and estimation, N m.
        same_reading: Whether a trial's later probes repeat its first reading wherever the ring is the same.
        max_probes: Probes after which a trial is undecided (assumed).
    """

    repeatability_m: float = 0.3e-3
    distribution: str = "uniform"
    height_sd_m: float = 0.1e-3
    training: int = 25
    training_lands: str = "each"
    mounting: str = GROUPED
    specimens: Specimens = "same"
    phantoms: int = 1
    trials: int = 100
    rehome: bool = True
    drift_n_m: float = 0.0
    same_reading: bool = False
    max_probes: int = 15

    def __post_init__(self) -> None:
        for name, allowed in (
            ("distribution", tuple(_SPREAD)),
            ("training_lands", ("each", "cell")),
            ("mounting", MOUNTINGS),
            ("specimens", get_args(Specimens)),
        ):
            if getattr(self, name) not in allowed:
                raise PalpError(f"no {name} '{getattr(self, name)}'; use one of {', '.join(allowed)}")
        if self.training < 2 or self.trials < 1 or self.max_probes < 1:
            raise PalpError("training needs 2 palpations a cell, a session one trial of one probe, at least")
        if not 1 <= self.phantoms <= min(self.training, self.trials):
            raise PalpError(
                f"{self.phantoms} phantoms per depth; choose 1 or more, no more than there are trials and "
                "palpations of a cell of training"
            )

    @property
    def training_mounts(self) -> int:
        """Mountings per depth in training."""
        return self.training if self.mounting == BLOCKS else self.phantoms

    @property
    def ring_sd_m(self) -> float:
        """Standard deviation of a landing."""
        return float(self.repeatability_m * _SPREAD[self.distribution])

    def landings_m(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Float64Array:
        """Return landing errors."""
        limit = self.repeatability_m
        match self.distribution:
            case "normal":
                return np.asarray(rng.normal(0.0, limit / 2.0, shape))
            case "triangular" if limit > 0.0:
                return np.asarray(rng.triangular(-limit, 0.0, limit, shape))
            case "two_sided":
                return np.asarray(rng.choice((-limit, limit), shape))
        return np.asarray(rng.uniform(-limit, limit, shape))
