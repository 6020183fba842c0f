"""A session on the simulated rig in numbers: training, what is learnt from it, and the trials to be decided.

All randomness of a session is drawn here, before any policy chooses: policies compared on a session meet the
same mountings, landings and noise at the same probe of the same trial.
"""

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.primitives import Primitives, fit, quantisation_sd
from palp_core.palpation.perception.belief.ring_curve import LEAST_RINGS, ring_curve
from palp_core.palpation.session.orders import BLOCKS, GROUPED, MOUNTINGS
from palp_core.palpation.session.plan import Specimens
from palp_core.palpation.studies.simulation.reading_table import ReadingTable
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
            trials of a phantom; a policy that moves it begins a trial elsewhere than it ended the last, and
            lands anew either way (that it may begin where it ended is left out). Not published.
        landing: A ``move`` lands anew; or each ``level`` has one landing for the whole of estimation.
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
    landing: str = "move"
    drift_n_m: float = 0.0
    same_reading: bool = False
    max_probes: int = 15

    def __post_init__(self) -> None:
        for name, allowed in (
            ("distribution", tuple(_SPREAD)),
            ("training_lands", ("each", "cell")),
            ("mounting", MOUNTINGS),
            ("specimens", get_args(Specimens)),
            ("landing", ("move", "level")),
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


@dataclass(frozen=True, eq=False)
class Trained:
    """What training left behind.

    Attributes:
        primitives: Fitted to all palpations.
        readings: The palpations, N m, shape (m, k, training).
    """

    primitives: Primitives
    readings: Float64Array


@dataclass(frozen=True, eq=False)
class Draws:
    """The luck of n trials of up to t probes.

    Attributes:
        depth: Class, shape (n,).
        height_m: Height of the surface, shape (n,).
        landing_m: Landing error if the ring moves before this probe, shape (n, t).
        fixed_landing_m: That of a fixed ring, kept from trial to trial without re-homing, shape (n,).
        level_landing_m: Landing error of each level, shape (k,); used with one landing per level.
        noise: Standard normal, shape (n, t).
        uniforms: For the policy, shape (n, t).
        bias_n_m: Of all readings of estimation.
    """

    depth: NDArray[np.int64]
    height_m: Float64Array
    landing_m: Float64Array
    fixed_landing_m: Float64Array
    level_landing_m: Float64Array
    noise: Float64Array
    uniforms: Float64Array
    bias_n_m: float


def train(table: ReadingTable, conditions: Conditions, rng: np.random.Generator) -> Trained:
    """Return what a training on the rig leaves: every depth at every ring position.

    Args:
        table: What is felt.
        conditions: The rig and the experiment.
        rng: Draws mountings, landings and noise.
    """
    m, k = len(table.gel.depths_m), len(table.gel.rings_m)
    count, mounts = conditions.training, conditions.training_mounts
    turn = np.arange(count)
    height_m = (conditions.height_sd_m * rng.standard_normal((m, 1, mounts)))[..., turn % mounts]
    landing_m = conditions.landings_m(rng, (m, k, count if conditions.training_lands == "each" else 1))
    depth, ring, _ = np.indices((m, k, count))
    readings = table.reading(
        depth.ravel(),
        ring.ravel(),
        np.broadcast_to(landing_m, depth.shape).ravel(),
        np.broadcast_to(height_m, depth.shape).ravel(),
        rng.standard_normal(depth.size),
    )
    primitives = fit(
        readings,
        depth.ravel().tolist(),
        ring.ravel().tolist(),
        depths_m=table.gel.depths_m,
        rings_m=table.gel.rings_m,
        floor=quantisation_sd(RESOLUTION_N_M),
    )
    return Trained(primitives, readings.reshape(depth.shape))


def draw(table: ReadingTable, conditions: Conditions, rng: np.random.Generator) -> Draws:
    """Return the luck of a session's trials: ``trials`` of every depth; the arguments are :func:`train`'s."""
    m, count = len(table.gel.depths_m), conditions.trials
    shape = (m * count, conditions.max_probes)
    depth = np.repeat(np.arange(m), count)
    height_m = conditions.height_sd_m * rng.standard_normal((m, count))
    turn = np.arange(count) % conditions.phantoms
    if conditions.mounting == GROUPED:
        height_m = height_m[:, turn]
    landing_m = conditions.landings_m(rng, shape)
    own_m = landing_m[:, 0]
    return Draws(
        depth,
        height_m.ravel(),
        landing_m,
        own_m if conditions.rehome else np.repeat(own_m[::count], count),
        conditions.landings_m(rng, (len(table.gel.rings_m),)),
        rng.standard_normal(shape),
        rng.random(shape),
        conditions.drift_n_m * float(rng.standard_normal()),
    )


def offset_model(trained: Trained, table: ReadingTable, conditions: Conditions) -> OffsetModel:
    """Return primitives that know what stays.

    Offsets: the ring's landing (until it moves), the height (for the trial), and the error that training left
    in each depth's mean (for the trial; its landings were as few as they were). Means lie on a curve over the
    ring through the session's own, where there are rings enough and the cells do not contradict it. Known
    from the rig, not from this session: the spreads of landing and height, the sensor's noise, and how a
    reading answers to both offsets. A height counts against that of the training's mounting, hence its
    variance twice; against their mean where training had many.
    """
    mean, rings_m = trained.primitives.mean, trained.primitives.rings_m
    landings = conditions.training if conditions.training_lands == "each" else 1
    ring, sd = table.ring_slope(), conditions.ring_sd_m
    noise = table.noise_sd**2 + trained.primitives.floor**2
    error_sd = np.sqrt((ring * sd) ** 2 / landings + noise / conditions.training)
    curve = ring_curve(mean, error_sd, rings_m) if len(rings_m) >= LEAST_RINGS else None
    if curve is not None and curve.fits:
        mean, root = curve.mean, curve.root
    else:
        root = error_sd[..., None] * np.eye(len(rings_m))
    own = np.stack([ring, table.height_slope()], axis=-1)
    slope = np.concatenate([own, root], axis=-1)[:, :, None, :]
    height_sd = np.sqrt(1.0 + 1.0 / conditions.training_mounts) * conditions.height_sd_m
    left = root.shape[-1]
    offset_sd = np.array([sd, height_sd, *[1.0] * left])
    return OffsetModel(
        mean[..., None], noise[..., None, None], slope, offset_sd, (True, *[False] * (1 + left))
    )
