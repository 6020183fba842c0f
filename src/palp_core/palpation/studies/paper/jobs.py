"""The work of the paper's study that is spread over processes: a session, or a scene's session, per job."""

from dataclasses import dataclass, replace

import numpy as np

from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.stopping import FixedNumber, PaperVerbatim, PosteriorThreshold
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import UniformRings
from palp_core.palpation.studies.simulation.conditions import Conditions, draw, train
from palp_core.palpation.studies.simulation.policies import (
    NAMES,
    STIFF_M,
    SessionCase,
    fixed_name,
    run_policy,
)
from palp_core.palpation.studies.simulation.reading_table import Gel, ReadingTable
from palp_core.palpation.studies.simulation.trials import Outcomes, TabledTrials, run_trials
from palp_core.units import Float64Array

READINGS = ("markov", "markov_gaussian_reset", "markov_mean")
GRID_M = tuple(float(d) for d in np.round(np.linspace(0.002, 0.008, 31), 7))

SCENES: dict[str, tuple[Gel, Conditions]] = {
    "easy": (Gel(), Conditions(height_sd_m=0.0, mounting="each_trial")),
    "noisy": (
        Gel(modulus_pa=30e3, noise_factor=5.0),
        Conditions(height_sd_m=0.1e-3, mounting="each_trial", training_lands="cell"),
    ),
    "unknown_height": (Gel(), Conditions(height_sd_m=0.2e-3, mounting="each_trial")),
    "noisy_re_homed": (
        Gel(modulus_pa=30e3, noise_factor=5.0),
        Conditions(height_sd_m=0.1e-3, mounting="each_trial"),
    ),
}
"""Fixed in advance: ring error only; noise, stiff gel and blocked training as well; height not known.

The last is a control, added afterwards: the noisy scene with a training that lands anew each time.
"""


def paper_session(case: SessionCase, seed: tuple[int, ...]) -> dict[str, Outcomes]:
    """Return what every policy does in a session: peak, the paper's filter, its stop rule verbatim."""
    session = case.begin(seed)
    names = [*NAMES, *READINGS[1:]]
    return {name: run_policy(name, session, PaperVerbatim()) for name in names}


def scene_session(case: SessionCase, seed: tuple[int, ...]) -> dict[str, Outcomes]:
    """Return the informed policies under the latent filter, and every fixed ring after 1, 2, ... probes."""
    session = case.begin(seed)
    stop = PosteriorThreshold()
    found = {
        "information_gain_latent": run_policy("information_gain_latent", session, stop, filter_name="latent"),
        "per_second": run_policy(
            "information_gain_latent", session, stop, filter_name="latent", per_second=True
        ),
        "naive": run_policy("information_gain", session, stop),
        "uniform": run_policy("uniform", session, stop, filter_name="latent"),
        "reposition_best": run_policy("reposition_best", session, stop, filter_name="latent"),
        "fixed_best": run_policy("fixed_best", session, stop, filter_name="latent"),
    }
    for ring_m in figure5.RINGS_M[1:]:
        name = fixed_name(ring_m)
        for filter_name in ("naive", "latent"):
            whole = run_policy(
                name, session, FixedNumber(case.conditions.max_probes), filter_name=filter_name
            )
            found[f"{name}/{filter_name}"] = whole
    return found


@dataclass(frozen=True, eq=False)
class GridCase:
    """Sessions whose nodules lie at any of 31 depths, while training knew three."""

    trained_touch: ReadingTable
    grid_touch: ReadingTable
    conditions: Conditions


def grid_session(case: GridCase, seed: tuple[int, ...]) -> dict[str, Float64Array]:
    """Return the squared error of the posterior mean depth, m^2, by filter: a mean over trials per probe."""
    training, estimation = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    primitives = train(case.trained_touch, case.conditions, training).primitives
    fine = primitives.interpolated(np.array(GRID_M))
    nothing = np.zeros((*fine.mean.shape, 1, 0))
    naive = OffsetModel(fine.mean[..., None], fine.sd[..., None, None] ** 2, nothing, np.zeros(0), ())
    aware = _aware(naive, case.grid_touch, case.conditions, primitives.floor)
    conditions = replace(case.conditions, trials=4)
    draws = draw(case.grid_touch, conditions, estimation)
    truth = np.array(GRID_M)[draws.depth]
    found = {}
    for name, model in (("naive", naive), ("latent", aware)):
        ended = run_trials(
            TabledTrials(case.grid_touch, conditions, draws),
            model,
            UniformRings(STIFF_M),
            FixedNumber(conditions.max_probes),
        )
        found[f"uniform_stiff, {name} filter"] = _squared(ended.expected_m, truth)
    return found


def _aware(model: OffsetModel, table: ReadingTable, conditions: Conditions, floor: float) -> OffsetModel:
    """Return interpolated primitives that know landing and height to stay."""
    slope = np.stack([table.ring_slope(), table.height_slope()], axis=-1)[:, :, None, :]
    sds = np.array([conditions.ring_sd_m, np.sqrt(2.0) * conditions.height_sd_m])
    noise = (table.noise_sd**2 + floor**2)[..., None, None]
    return OffsetModel(model.mean, noise, slope, sds, (True, False))


def _squared(expected_m: Float64Array, truth_m: Float64Array) -> Float64Array:
    return np.asarray(((expected_m - truth_m[:, None]) ** 2).mean(axis=0))
