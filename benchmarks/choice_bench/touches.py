"""Tasks of signals and sessions: random gels, rings, rigs and trainings, felt on the simulated rig.

The truth is what was simulated: the feature of a sweep before the noise, the depth that was touched. The
contact is L2's throughout. Three in four touches are where the stated errors of sessions hold, the others
about it or beyond; of the rigs and trainings likewise. The tasks of one index share their touch.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.choice_bench.contest import Case, Reading, log_between, mean_reading
from palp_core.methods import names
from palp_core.palpation.perception.belief.stopping import FixedNumber, StopRule, stop_rule
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    StiffnessPolicy,
    UniformRings,
)
from palp_core.palpation.studies.decision.feature_cases import clean_cases
from palp_core.palpation.studies.decision.feature_cases import measure as errors_of
from palp_core.palpation.studies.perception.beliefs import REMOUNTED, RULES, decided, miscalibrated
from palp_core.palpation.studies.perception.case import in_words, session_quantities, touch_quantities
from palp_core.palpation.studies.perception.signals import ways
from palp_core.palpation.studies.perception.trials import FILTERS, policy_of
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import SimulatedSession, begin_session
from palp_core.palpation.studies.simulation.reading_table import Gel, tabulate
from palp_core.palpation.studies.simulation.trials import Outcomes, run_trials
from palp_core.units import Float64Array

SESSIONS = 30
"""Of the first round; each further one has three times as many."""
_SWEEPS = 16
_POLICIES: Sequence[StiffnessPolicy] = (FixedRing(), UniformRings(), MarkovPolicy())


@dataclass(frozen=True)
class Drawn:
    """What a scene is."""

    gel: Gel
    conditions: Conditions
    seed: tuple[int, ...]


def touch(rng: np.random.Generator, index: int) -> Drawn:
    """Return a touch, a rig and a training."""
    where = float(rng.random())
    usual, beyond = where < 0.75, where > 0.88
    most = 3 if usual else 5 if beyond else 4
    gel = Gel(
        depths_m=_depths_m(rng, int(rng.integers(2, most + 1)), beyond=beyond),
        modulus_pa=_between(rng, usual, beyond, (19.5e3, 20.5e3), (15e3, 30e3), (8e3, 60e3)),
        friction=_between(rng, usual, beyond, (0.29, 0.31), (0.25, 0.45), (0.15, 0.55)),
        indentation_m=_between(rng, usual, beyond, (3.9e-3, 4.1e-3), (3e-3, 5e-3), (2.5e-3, 5.5e-3)),
        noise_factor=float(rng.uniform(0.3, 1.0)) if rng.random() < 0.9 else log_between(rng, 1.0, 7.0),
        rung="l2",
        height_reach_m=0.9e-3,
    )
    conditions = replace(
        REMOUNTED,
        repeatability_m=0.3e-3
        if rng.random() < 0.3
        else float(rng.uniform(0.0, 0.5e-3 if beyond else 0.3e-3)),
        height_sd_m=float(rng.uniform(0.0, 0.2e-3 if beyond or rng.random() < 0.07 else 0.1e-3)),
        training=25 if rng.random() < 0.5 else int(rng.integers(4 if beyond else 20, 61)),
        max_probes=15 if rng.random() < 0.93 else int(rng.integers(5, 26)),
    )
    return Drawn(gel, conditions, (int(rng.integers(1 << 31)), index))


def _between(rng: np.random.Generator, usual: bool, beyond: bool, *ranges: tuple[float, float]) -> float:
    return float(rng.uniform(*ranges[0 if usual else 2 if beyond else 1]))


def _depths_m(rng: np.random.Generator, count: int, *, beyond: bool) -> tuple[float, ...]:
    low, high, ratio = (0.001, 0.014, 1.3) if beyond else (0.0015, 0.012, 2.0)
    apart = math.log(ratio) * np.arange(count)
    free = max(math.log(high / low) - apart[-1], 0.0)
    return tuple(round(float(one), 9) for one in low * np.exp(np.sort(rng.uniform(0.0, free, count)) + apart))


def _words(of: Drawn, conditions: Conditions | None = None) -> str:
    depths = ", ".join(f"{one * 1e3:.3g}" for one in of.gel.depths_m)
    rest = in_words(replace(of.gel, depths_m=Gel().depths_m, rung="", height_reach_m=1.5e-3), conditions)
    return f"{depths} mm; {rest}"


# denoise: a feature against that of the sweep without noise


def denoise(rng: np.random.Generator, index: int) -> Case:
    """Draw two rings at which a touch is felt, and a tolerance of the feature over the least gap."""
    of = touch(rng, index)
    low, high = (0.004, 0.016) if rng.random() < 0.85 else (0.0005, 0.02)
    rings_m = tuple(sorted(float(one) for one in rng.uniform(low, high, 2)))
    noise = log_between(rng, 0.3, 7.0)
    gel = replace(of.gel, rings_m=rings_m, noise_factor=noise)
    cases = clean_cases(rings_m, gel)
    made = {one.family: one for one in ways()}

    def measure(name: str, number: int) -> Reading:
        count, chance = _SWEEPS * 4**number, np.random.default_rng((*of.seed, number))
        rows = (row for case in cases for row in errors_of(made[name], [case], noise, count, chance))
        worst = max(row.relative for row in rows)
        return Reading(worst, worst / np.sqrt(2.0 * count))

    rings = " and ".join(f"{one * 1e3:.3g}" for one in rings_m)
    words = f"{_words(replace(of, gel=replace(gel, rings_m=Gel().rings_m)))}; rings {rings} mm"
    quantities = touch_quantities(gel) | {"ring_m": rings_m}
    return Case("denoise", "feature", log_between(rng, 0.008, 1.0), quantities, measure, words)


# sessions


@functools.lru_cache(maxsize=8)
def sessions(of: Drawn, number: int) -> list[SimulatedSession]:
    """Return the sessions of a round."""
    felt = tabulate(of.gel)
    return [
        begin_session(felt, of.conditions, (*of.seed, number, one)) for one in range(SESSIONS * 3**number)
    ]


@functools.lru_cache(maxsize=256)
def _ended(of: Drawn, number: int, known: str, policy: str, rule: StopRule) -> list[Outcomes]:
    """Return how trials end; of a policy by its name in the register, told of each session."""
    found = []
    for one in sessions(of, number):
        made = policy_of(policy, one)
        assert made is not None
        found.append(decided(one, known, made, rule))
    return found


def feature(rng: np.random.Generator, index: int) -> Case:
    """Draw a tolerance of wrong decisions from one reading at the stiffest of two rings."""
    of = touch(rng, index)
    stiffest_m = 0.016 if rng.random() < 0.85 else float(rng.uniform(0.008, 0.02))
    of = replace(of, gel=replace(of.gel, rings_m=(0.004, stiffest_m)))

    def measure(name: str, number: int) -> Reading:
        by = replace(of, gel=replace(of.gel, feature=name))
        policy = FixedRing(stiffest_m)
        ended = [run_trials(one.felt, one.naive, policy, FixedNumber(1)) for one in sessions(by, number)]
        return mean_reading([np.mean(~one.correct) for one in ended])

    quantities = session_quantities(of.gel, of.conditions)
    words = f"{_words(of, of.conditions)}; at {stiffest_m * 1e3:.3g} mm"
    return Case("feature", "decision", log_between(rng, 0.003, 0.5), quantities, measure, words)


def filtering(rng: np.random.Generator, index: int) -> Case:
    """Draw a tolerance of the calibration at the end of trials, worst of three policies and two rules."""
    of = touch(rng, index)

    def measure(name: str, number: int) -> Reading:
        found = []
        for policy in _POLICIES:
            for rule in RULES:
                ended = [decided(one, name, policy, rule) for one in sessions(of, number)]
                apart = mean_reading([np.mean(one.confidence - one.correct) for one in ended])
                found.append(Reading(miscalibrated(ended), apart.sd))
        return max(found, key=lambda one: one.error)

    quantities = session_quantities(of.gel, of.conditions)
    tolerance = log_between(rng, 0.012, 0.3)
    return Case("filter", "calibration", tolerance, quantities, measure, _words(of, of.conditions))


def stop(rng: np.random.Generator, index: int) -> Case:
    """Draw a tolerance of decisions lost against going on, worst of two policies and two filters."""
    of = touch(rng, index)

    def measure(name: str, number: int) -> Reading:
        found = []
        for policy in ("fixed", "uniform"):
            for known in FILTERS:
                last = _ended(of, number, known, policy, FixedNumber(of.conditions.max_probes))
                ended = _ended(of, number, known, policy, stop_rule(name))
                found.append(mean_reading(_wrong(ended) - _wrong(last)))
        return max(found, key=lambda one: one.error)

    quantities = session_quantities(of.gel, of.conditions)
    tolerance = log_between(rng, 0.02, 0.25)
    return Case("stop", "decision", tolerance, quantities, measure, _words(of, of.conditions))


def policy(rng: np.random.Generator, index: int) -> Case:
    """Draw a tolerance of decisions lost against the best of all policies, worse of two filters."""
    of = touch(rng, index)

    def measure(name: str, number: int) -> Reading:
        begun = sessions(of, number)[0]
        others = [one for one in names("policy") if policy_of(one, begun) is not None]
        if name not in others:
            return Reading(np.inf)  # it takes a person, or whole traces
        found = []
        for known in FILTERS:
            wrong = {one: _wrong(_ended(of, number, known, one, RULES[0])) for one in others}
            best = min(wrong.values(), key=np.mean)
            found.append(mean_reading(wrong[name] - best))
        return max(found, key=lambda one: one.error)

    quantities = session_quantities(of.gel, of.conditions)
    tolerance = log_between(rng, 0.02, 0.25)
    return Case("policy", "decision", tolerance, quantities, measure, _words(of, of.conditions))


def _wrong(ended: Sequence[Outcomes]) -> Float64Array:
    """Return the share of wrong decisions by session."""
    return np.array([np.mean(~one.correct) for one in ended])


CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {
    "denoise": denoise,
    "feature": feature,
    "filter": filtering,
    "stop": stop,
    "policy": policy,
}
