"""Every policy by name, and what it does in one session of the simulated rig.

The names are those of ``paper.json``. Each policy meets the same trials with the same luck.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PalpError
from palp_core.methods import find
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.rig_noise import independent_model
from palp_core.palpation.perception.belief.stopping import FixedNumber, StopRule
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    StiffnessPolicy,
    UniformRings,
)
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent, Reposition
from palp_core.palpation.studies.simulation.conditions import (
    Conditions,
    Draws,
    Trained,
    draw,
    offset_model,
    train,
)
from palp_core.palpation.studies.simulation.reading_table import ReadingTable
from palp_core.palpation.studies.simulation.trials import Outcomes, TabledTrials, run_trials
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
class SimulatedSession:
    """A session after its training.

    Attributes:
        table: What is felt.
        conditions: The rig and the experiment.
        trained: What training left.
        draws: The luck of the trials.
        naive: The paper's filter.
        latent: The filter that knows what stays.
        best_ring_m: The best ring position by validation within training.
        order: A permutation of levels, neither the identity nor its reversal.
    """

    table: ReadingTable
    conditions: Conditions
    trained: Trained
    draws: Draws
    naive: latent.OffsetModel
    latent: latent.OffsetModel
    best_ring_m: float
    order: tuple[int, ...]

    @property
    def felt(self) -> TabledTrials:
        """Its trials."""
        return TabledTrials(self.table, self.conditions, self.draws)


def begin_session(table: ReadingTable, conditions: Conditions, seed: Sequence[int]) -> SimulatedSession:
    """Train a session and draw its trials.

    Args:
        table: What is felt.
        conditions: The rig and the experiment.
        seed: Numbers that name the session; training and trials have streams of their own.
    """
    training, estimation, shuffling = (
        np.random.default_rng(s) for s in np.random.SeedSequence(list(seed)).spawn(3)
    )
    trained = train(table, conditions, training)
    return SimulatedSession(
        table,
        conditions,
        trained,
        draw(table, conditions, estimation),
        independent_model(trained.primitives),
        offset_model(trained, table, conditions),
        table.gel.rings_m[best_ring(trained.readings)],
        _order(len(figure5.LEVELS), shuffling),
    )


@dataclass(frozen=True, eq=False)
class SessionCase:
    """Sessions alike: what is felt, and the rig and the experiment."""

    table: ReadingTable
    conditions: Conditions

    def begin(self, seed: tuple[int, ...]) -> SimulatedSession:
        """Train a session and draw its trials."""
        return begin_session(self.table, self.conditions, seed)


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


def _order(count: int, rng: np.random.Generator) -> tuple[int, ...]:
    """Draw a permutation of the levels that is neither the identity nor the reversal."""
    while True:
        order = tuple(int(i) for i in rng.permutation(count))
        if order not in (tuple(range(count)), tuple(reversed(range(count)))):
            return order


def policy(name: str, session: SimulatedSession, *, per_second: bool = False) -> StiffnessPolicy:
    """Return a policy by the name it has in every table.

    Args:
        name: As in ``paper.json``.
        session: Where its knowledge comes from.
        per_second: Whether the informed ones weigh seconds.

    Raises:
        PalpError: There is none of that name.
    """
    rings_m = session.table.gel.rings_m
    if name.startswith("fixed_") and name.removeprefix("fixed_").replace(".", "").isdigit():
        return FixedRing(round(float(name.removeprefix("fixed_")) * 1e-3, 9))
    if name.startswith("markov"):
        return _chain(name, session)
    match name:
        case "fixed_best" | "best_single_probe":
            return FixedRing(session.best_ring_m)
        case "reposition_best":
            return Reposition(session.best_ring_m)
        case "uniform":
            return UniformRings(rings_m)
        case "uniform_stiff":
            return UniformRings(STIFF_M)
        case "information_gain":
            return InformationGainLatent(session.naive, rings_m, per_second=per_second)
        case "information_gain_latent":
            return InformationGainLatent(session.latent, rings_m, per_second=per_second)
    raise PalpError(f"there is no policy '{name}'; there are {', '.join(NAMES)}")


def _chain(name: str, session: SimulatedSession) -> MarkovPolicy:
    matrix = MarkovPolicy().matrices.mean(axis=0)
    match name:
        case "markov":
            return MarkovPolicy()
        case "markov_stationary":
            return MarkovPolicy(markov.independent(matrix)[None])
        case "markov_reversed":
            return MarkovPolicy(markov.time_reversed(matrix)[None])
        case "markov_permuted":
            return MarkovPolicy(markov.permuted(matrix, session.order)[None])
        case "markov_gaussian_reset":
            return MarkovPolicy(reading="gaussian_reset")
        case "markov_mean":
            return MarkovPolicy(reading="mean")
    raise PalpError(f"there is no policy '{name}'; there are {', '.join(NAMES)}")


def run_policy(
    name: str,
    session: SimulatedSession,
    stop: StopRule,
    *,
    filter_name: str = "naive",
    per_second: bool = False,
) -> Outcomes:
    """Run a policy in a session.

    Args:
        name: As in ``paper.json``.
        session: The session.
        stop: The stop rule; a single probe has its own.
        filter_name: Task ``filter``.
        per_second: Whether the informed policies weigh seconds.
    """
    if name == "chance":
        return chance(session)
    known = find("filter", filter_name).target
    model = session.naive if filter_name == "naive" else known(session.latent)
    chosen = policy(name, session, per_second=per_second)
    rule = FixedNumber(1) if name == "best_single_probe" else stop
    return run_trials(session.felt, model, chosen, rule)


def chance(session: SimulatedSession) -> Outcomes:
    """Return the outcomes of guessing without a probe."""
    draws, m = session.draws, len(session.table.gel.depths_m)
    count, most = draws.uniforms.shape
    guess = (draws.uniforms[:, 0] * m).astype(np.int64)
    none = np.zeros(count, dtype=np.int64)
    return Outcomes(
        draws.depth,
        guess,
        np.full(count, 1.0 / m),
        none,
        none,
        np.zeros(count),
        np.ones(count, dtype=bool),
        np.full((count, most), float(np.mean(session.table.gel.depths_m))),
        np.repeat((guess == draws.depth)[:, None], most, axis=1),
    )
