"""Every policy by name, and what it does in one session of the simulated rig.

The names are those of ``paper.json``. Each policy meets the same trials with the same luck.
"""

import functools
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PalpError
from palp_core.methods import find
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.primitives import Primitives, fit, quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import (
    RigNoise,
    independent_model,
    latent_model,
    on_depths,
)
from palp_core.palpation.perception.belief.stopping import FixedNumber, StopRule
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    StiffnessPolicy,
    UniformRings,
)
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent, Reposition
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.studies.simulation.cells import informed_model
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.session import FeatureTrials, WorldPlan, WorldSession, begin
from palp_core.palpation.studies.simulation.trials import Outcomes, run_trials
from palp_core.units import Float64Array


def fixed_name(ring_m: float) -> str:
    """Return the name of the policy that stays at a ring position, as ``fixed_16``."""
    return f"fixed_{ring_m * 1e3:g}"


FIXED = tuple(fixed_name(ring_m) for ring_m in figure5.RINGS_M)
"""The paper's fixed positions, whose mean is ``fixed_average``."""

NAMES = (
    "chance",
    "best_single_probe",
    *FIXED,
    "fixed_best",
    "markov",
    "markov_stationary",
    "markov_reversed",
    "markov_permuted",
    "uniform",
    "uniform_stiff",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)
"""All but ``fixed_average``, which is a mean of others."""

STIFF_M = (0.008, 0.012, 0.016)


@dataclass(frozen=True, eq=False)
class TrainedFeature:
    """What a session's training leaves to decisions by one feature.

    Attributes:
        trials: The trials, as readings of the feature.
        primitives: Fitted to the readings of training.
        best_ring: Index of the position whose single readings are best decided within training.
        naive: The paper's filter.
        latent: The one that knows what stays.
    """

    trials: FeatureTrials
    primitives: Primitives
    best_ring: int
    naive: OffsetModel
    latent: OffsetModel

    @property
    def best_ring_m(self) -> float:
        """Position whose single readings are best decided within training."""
        return self.trials.rings_m[self.best_ring]


def train_feature(
    session: WorldSession, feature: str, *, grid_m: tuple[float, ...] = (), noise: RigNoise | None = None
) -> TrainedFeature:
    """Return what training leaves, as the estimator on a rig has it: from its readings and a scene file.

    Args:
        session: The session.
        feature: What is read off its sweeps.
        grid_m: Depths of the filters, where these are not the trained ones; with ``noise``.
        noise: What the latent filter assumes of the rig; None: it is handed what is true of the objects that
            make the readings.
    """
    training, plan, trials = session.training, session.plan, session.feature(feature, grid_m)
    gel, readings = plan.gel, trials.training()
    primitives = fit(
        readings,
        training.depth.tolist(),
        training.ring.tolist(),
        depths_m=gel.depths_m,
        rings_m=gel.rings_m,
        floor=quantisation_sd(RESOLUTION_N_M),
    )
    cells = readings.reshape(len(gel.depths_m), len(gel.rings_m), -1)
    naive = latent = independent_model(primitives)
    if len(gel.rings_m) < 2:
        pass  # nothing tells how a reading answers to the ring
    elif noise is None:
        latent = informed_model(primitives, plan, feature)
    else:
        slope = _height_slope(gel, feature)
        if grid_m:
            grid = np.asarray(grid_m)
            primitives = primitives.interpolated(grid)
            naive = independent_model(primitives)
            slope = on_depths(slope, np.asarray(gel.depths_m), grid)
        latent = latent_model(primitives, noise, slope)
    return TrainedFeature(trials, primitives, best_ring(cells), naive, latent)


@functools.lru_cache(maxsize=64)
def _height_slope(gel: Gel, feature: str) -> Float64Array:
    return height_slope(gel.depths_m, gel.rings_m, feature, gel.scene(gel.depths_m[0]))


def begin_trained(plan: WorldPlan, seed: tuple[int, ...]) -> TrainedFeature:
    """Draw a session, and return what its training leaves to decisions by its gel's feature."""
    return train_feature(begin(plan, seed), plan.gel.reading)


def best_ring(readings: Float64Array) -> int:
    """Return the ring position whose single readings are best decided, by leaving out one palpation a cell.

    Args:
        readings: Training palpations, shape (m, k, n).

    Returns:
        Index of the position; of equals, the one with the largest mean log posterior.
    """
    count = readings.shape[2]
    total = readings.sum(axis=2, keepdims=True)
    mean = (total - readings) / (count - 1)  # without the palpation itself, (m, k, n)
    squares = (readings**2).sum(axis=2, keepdims=True) - readings**2
    variance = np.maximum(squares - (count - 1) * mean**2, 0.0) / max(count - 2, 1) + 1e-12
    # palpation n of class c against class d; only d = c is without it, which is what matters least for d != c
    z = readings[:, None] - mean[None]
    log = -0.5 * z**2 / variance[None] - 0.5 * np.log(variance)[None]  # (c, d, k, n)
    own = np.einsum("cckn->ckn", log)
    top = log.max(axis=1)
    share = (own >= top).mean(axis=(0, 2))
    sure = (own - np.log(np.exp(log - top[:, None]).sum(axis=1)) - top).mean(axis=(0, 2))
    return int(np.lexsort((sure, share))[-1])


def policy(name: str, trained: TrainedFeature, *, per_second: bool = False) -> StiffnessPolicy:
    """Return a policy by the name it has in every table.

    Args:
        name: As in ``paper.json``.
        trained: Where its knowledge comes from.
        per_second: Whether the informed ones weigh seconds.
    """
    rings_m = trained.trials.rings_m
    if name.startswith("fixed_") and name.removeprefix("fixed_").replace(".", "").isdigit():
        return FixedRing(round(float(name.removeprefix("fixed_")) * 1e-3, 9))
    if name.startswith("markov"):
        return _chain(name, trained)
    match name:
        case "fixed_best" | "best_single_probe":
            return FixedRing(trained.best_ring_m)
        case "reposition_best":
            return Reposition(trained.best_ring_m)
        case "uniform":
            return UniformRings(rings_m)
        case "uniform_stiff":
            return UniformRings(STIFF_M)
        case "information_gain":
            return InformationGainLatent(trained.naive, rings_m, per_second=per_second)
        case "information_gain_latent":
            return InformationGainLatent(trained.latent, rings_m, per_second=per_second)
    raise PalpError(f"there is no policy '{name}'; there are {', '.join(NAMES)}")


def _chain(name: str, trained: TrainedFeature) -> MarkovPolicy:
    matrix = MarkovPolicy().matrices.mean(axis=0)
    match name:
        case "markov":
            return MarkovPolicy()
        case "markov_stationary":
            return MarkovPolicy(markov.independent(matrix)[None])
        case "markov_reversed":
            return MarkovPolicy(markov.time_reversed(matrix)[None])
        case "markov_permuted":
            return MarkovPolicy(markov.permuted(matrix, trained.trials.session.order)[None])
        case "markov_gaussian_reset":
            return MarkovPolicy(reading="gaussian_reset")
        case "markov_mean":
            return MarkovPolicy(reading="mean")
    raise PalpError(f"there is no policy '{name}'; there are {', '.join(NAMES)}")


def run_policy(
    name: str,
    trained: TrainedFeature,
    stop: StopRule,
    *,
    filter_name: str = "naive",
    per_second: bool = False,
) -> Outcomes:
    """Run a policy in a session.

    Args:
        name: As in ``paper.json``.
        trained: The session, after its training.
        stop: The stop rule; a single probe has its own.
        filter_name: Task ``filter``.
        per_second: Whether the informed policies weigh seconds.
    """
    if name == "chance":
        return chance(trained)
    known = find("filter", filter_name).target
    model = trained.naive if filter_name == "naive" else known(trained.latent)
    chosen = policy(name, trained, per_second=per_second)
    rule = FixedNumber(1) if name == "best_single_probe" else stop
    return run_trials(trained.trials, model, chosen, rule)


def chance(trained: TrainedFeature) -> Outcomes:
    """Return the outcomes of guessing without a probe."""
    trials, m = trained.trials, len(trained.trials.depths_m)
    count, most = trials.uniforms.shape
    guess = (trials.uniforms[:, 0] * m).astype(np.int64)
    none = np.zeros(count, dtype=np.int64)
    return Outcomes(
        trials.depth,
        guess,
        np.full(count, 1.0 / m),
        none,
        none,
        np.zeros(count),
        np.ones(count, dtype=bool),
        np.full((count, most), float(np.mean(trials.depths_m))),
        np.repeat((guess == trials.depth)[:, None], most, axis=1),
    )
