"""The work of the study ``power``: a pool of sessions on the simulated rig, and trials drawn from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.palpation.perception.belief.stopping import PaperVerbatim
from palp_core.palpation.studies.power import model
from palp_core.palpation.studies.simulation.policies import FIXED, SessionJob, fixed_name, run_policy
from palp_core.units import Float64Array

POLICIES = ("fixed_average", "fixed_best", "markov", "uniform", "information_gain_latent")
COMPARISONS = (
    ("markov", "fixed_average"),
    ("markov", "uniform"),
    ("markov", "fixed_best"),
    ("information_gain_latent", "fixed_best"),
)
"""First minus second, one family for Holm."""

Pool = Mapping[str, Float64Array]


def pool_session(job: SessionJob) -> dict[str, Float64Array]:
    """Return the share of right answers at each depth by policy, shape (m,)."""
    session = job.begin()
    shares: dict[str, Float64Array] = {}
    for name in (*FIXED, *POLICIES[1:]):
        if name == "fixed_best":
            shares[name] = shares[fixed_name(session.best_ring_m)]
            continue
        found = run_policy(name, session, PaperVerbatim())
        shares[name] = found.correct.reshape(len(job.table.gel.depths_m), -1).mean(axis=1)
    shares["fixed_average"] = np.mean([shares[name] for name in FIXED], axis=0)
    return {name: shares[name] for name in POLICIES}


@dataclass(frozen=True, eq=False)
class CurveJob:
    """Experiments to be repeated, all of the same length of session.

    Attributes:
        pool: Share of right answers by policy, shape (s, m).
        trials: Per depth and session.
        sessions: How many, one after the other.
        repeats: Of each experiment.
        seed: Of the draws.
    """

    pool: Pool
    trials: int
    sessions: tuple[int, ...]
    repeats: int
    seed: tuple[int, ...]


def curve_points(job: CurveJob) -> list[dict[str, float | int | str]]:
    """Return the power of each comparison at each number of sessions, alone and within its family (Holm).

    Sessions are drawn from the pool with replacement. All policies meet a session's training and mountings;
    their trials are their own, as they would be on a rig.
    """
    rng = np.random.default_rng(job.seed)
    rows: list[dict[str, float | int | str]] = []
    for count in job.sessions:
        which = rng.integers(0, len(job.pool["markov"]), (job.repeats, count))
        shares = {name: _felt(job.pool[name][which], job.trials, rng) for name in POLICIES}
        p = np.stack([model.paired_p(shares[a] - shares[b]) for a, b in COMPARISONS], axis=1)
        within = model.holm_rows(p)
        rows += [
            {
                "comparison": f"{first} - {second}",
                "trials": job.trials,
                "sessions": count,
                "power": float(np.mean(p[:, c] < 0.05)),
                "power_holm": float(np.mean(within[:, c] < 0.05)),
            }
            for c, (first, second) in enumerate(COMPARISONS)
        ]
    return rows


def _felt(shares: Float64Array, trials: int, rng: np.random.Generator) -> Float64Array:
    """Return what sessions of so many trials per depth show, averaged over depths; shape without the last."""
    return np.asarray(rng.binomial(trials, np.clip(shares, 0.0, 1.0)).mean(axis=-1) / trials)


def false_alarms(shares: Float64Array, trials: int, repeats: int, rng: np.random.Generator) -> float:
    """Return how often a test of two proportions tells a policy from itself, a session each, at 0.05.

    Args:
        shares: Of the policy's sessions, shape (s, m).
        trials: Per depth.
        repeats: Pairs of sessions.
        rng: Of the draws.
    """
    which = rng.integers(0, len(shares), (2, repeats))
    right = np.round(_felt(shares[which], trials, rng) * trials * shares.shape[1])
    return float(np.mean(model.pooled_p(right[0], right[1], trials * shares.shape[1]) < 0.05))


def published_power(
    first: model.Law,
    second: model.Law,
    sessions: Sequence[int],
    trials: int,
    repeats: int,
    rng: np.random.Generator,
) -> list[float]:
    """Return the power to tell two published shares apart, sessions of their own each, by Welch's test.

    Args:
        first: One arm.
        second: The other.
        sessions: Of each arm.
        trials: Of each session.
        repeats: Of the experiment.
        rng: Of the draws.
    """
    powers = []
    for count in sessions:
        arms = [
            rng.binomial(trials, model.beta_sessions(arm, (repeats, count), rng)) / trials
            for arm in (first, second)
        ]
        powers.append(float(np.mean(model.unpaired_p(arms[0], arms[1]) < 0.05)))
    return powers


def depth_power(
    shares: Sequence[float],
    correlation: float,
    subjects: Sequence[int],
    trials: int,
    repeats: int,
    rng: np.random.Generator,
) -> list[float]:
    """Return the power to tell a subject's share at one depth from that at the others, paired.

    Args:
        shares: At each depth; the first is compared with the mean of the others.
        correlation: Within a subject at a depth.
        subjects: How many, one experiment after the other.
        trials: Per subject and depth.
        repeats: Of each experiment.
        rng: Of the draws.
    """
    powers = []
    for count in subjects:
        seen = [
            rng.binomial(trials, model.beta_sessions(model.Law(share, correlation), (repeats, count), rng))
            / trials
            for share in shares
        ]
        powers.append(float(np.mean(model.paired_p(seen[0] - np.mean(seen[1:], axis=0)) < 0.05)))
    return powers
