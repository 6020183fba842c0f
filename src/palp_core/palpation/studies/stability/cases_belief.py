"""Cases T1 to T6: the stop rule, the belief and the memory primitives."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.distance import correlation

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.stopping import BeliefStep, PaperGuarded, PaperVerbatim, StopRule
from palp_core.palpation.perception.strategy import markov
from palp_core.palpation.studies.stability.case import Case, compare_once
from palp_core.units import Float64Array

FLAT = np.full(3, 1 / 3)
LIMIT = 0.0005


def naive_gain(posterior: Float64Array, prior: Float64Array) -> Float64Array:
    """Return eq. (8) as printed."""
    return np.asarray(posterior * np.log(posterior / prior))


def naive_stop(posteriors: Sequence[Float64Array]) -> bool:
    """Return whether the loop of Algorithm 1 ends, as printed: it goes on while gamma > T, from G_0 = 0."""
    prior = np.full(posteriors[0].size, 1.0 / posteriors[0].size)
    before = naive_gain(posteriors[-2], prior) if len(posteriors) > 1 else np.zeros(posteriors[0].size)
    return not correlation(before, naive_gain(posteriors[-1], prior)) > LIMIT


def our_stop(rule: StopRule, posteriors: Sequence[Float64Array]) -> bool:
    """Return whether a rule stops."""
    prior = np.full(posteriors[0].size, 1.0 / posteriors[0].size)
    gains = [gain_vector(p, prior) for p in posteriors]
    return bool(rule.check(BeliefStep.last(posteriors, gains)).converged)


def _stops(stop: Any) -> str:
    return "stops" if stop else "goes on"


def _law(found: Any) -> str:
    return np.array2string(np.asarray(found), precision=3, suppress_small=True)


def _finite(found: Any) -> bool:
    return not isinstance(found, Exception) and bool(np.isfinite(found).all())


def naive_posterior(reading: float, mean: Float64Array, sd: float) -> Float64Array:
    """Return eq. (7) as printed, from a flat prior: densities multiplied."""
    density = np.exp(-0.5 * ((reading - mean) / sd) ** 2)
    return np.asarray(density * FLAT / (density * FLAT).sum())


def _our_posterior() -> Float64Array:
    cells = Primitives(
        np.array([2.0, 4.0, 8.0]),
        np.zeros(1),
        np.array([[10.0], [20.0], [30.0]]),
        np.full((3, 1), 0.3),
        np.full((3, 1), 25.0),
        0.01,
    )
    if not cells.is_outlier(60.0, 0):
        raise PerceptionError("the outlier was not seen")
    return bayes.posterior(bayes.update(bayes.flat_prior(3), cells.log_likelihood(60.0, 0)))


PEAKS = np.array([1.0] * 25 + [2.0] * 25)


def _naive_cells() -> Float64Array:
    sd = PEAKS.reshape(2, 25).std(axis=1, ddof=1)
    density = np.exp(-0.5 * ((1.2 - np.array([1.0, 2.0])) / sd) ** 2) / sd
    return np.asarray(density / density.sum())


def _our_cells() -> Float64Array:
    known = fit(PEAKS, [0] * 25 + [1] * 25, [0] * 50, depths_m=[0.002, 0.004], rings_m=[0.0], floor=0.05)
    return bayes.posterior(bayes.update(bayes.flat_prior(2), known.log_likelihood(1.2, 0, model="student_t")))


VISITS = [[0, 1, 0, 1], [2, 2]]


def _naive_chain() -> Float64Array:
    counts = np.zeros((4, 4))
    joined = np.concatenate(VISITS)
    np.add.at(counts, (joined[1:], joined[:-1]), 1.0)
    return np.asarray(counts / counts.sum(axis=0))


def _our_chain() -> Float64Array:
    return markov.transition_matrix(markov.count_transitions(VISITS, 4))


def _is_chain(found: Any) -> bool:
    """Whether it is a chain in which a level that was never left is left now and then."""
    return _finite(found) and bool(np.allclose(np.sum(found, axis=0), 1.0)) and bool(found[2, 1] < 0.2)


ONE_HOT = np.array([1.0, 0.0, 0.0])


def belief_cases() -> list[Case]:
    """Return the cases, each with the smallest input at which the naive method fails."""
    return [
        compare_once(
            "T1",
            "gamma at the first probe",
            "P_1 = [0.6, 0.3, 0.1], G_0 = 0",
            "`while gamma > T`: undefined ends the loop",
            "undefined is not converged",
            lambda: naive_stop([np.array([0.6, 0.3, 0.1])]),
            lambda: our_stop(PaperVerbatim(), [np.array([0.6, 0.3, 0.1])]),
            lambda stop: stop is False,
            _stops,
        ),
        compare_once(
            "T1b",
            "a belief that is certain",
            "P = [1, 0, 0]",
            "P log(P / P_0)",
            "0 log 0 = 0",
            lambda: naive_gain(ONE_HOT, FLAT),
            lambda: gain_vector(ONE_HOT, FLAT),
            _finite,
            _law,
        ),
        compare_once(
            "T1c",
            "probes without information",
            "P_1 = P_2 = P_0",
            "correlation of two zero vectors",
            "no stop on a gain without variance",
            lambda: naive_stop([FLAT, FLAT]),
            lambda: our_stop(PaperVerbatim(), [FLAT, FLAT]),
            lambda stop: stop is False,
            _stops,
        ),
        compare_once(
            "T2",
            "two depths",
            "P_1 = [0.51, 0.49], P_2 = [0.52, 0.48]",
            "the distance is 0: stops on next to nothing",
            "refused, alternatives named",
            lambda: naive_stop([np.array([0.51, 0.49]), np.array([0.52, 0.48])]),
            lambda: our_stop(PaperVerbatim(), [np.array([0.51, 0.49]), np.array([0.52, 0.48])]),
            lambda found: isinstance(found, PerceptionError) and "posterior_threshold" in str(found),
            _stops,
        ),
        compare_once(
            "T3",
            "a belief that grows along one direction",
            "[0.4, 0.3, 0.3], then [0.9, 0.05, 0.05]",
            "the published rule",
            "`paper_guarded`: the posterior must have settled too",
            lambda: our_stop(PaperVerbatim(), [np.array([0.4, 0.3, 0.3]), np.array([0.9, 0.05, 0.05])]),
            lambda: our_stop(PaperGuarded(), [np.array([0.4, 0.3, 0.3]), np.array([0.9, 0.05, 0.05])]),
            lambda stop: stop is False,
            _stops,
        ),
        compare_once(
            "T4",
            "an outlier",
            "60 against means 10, 20, 30 with sd 0.3",
            "densities multiplied",
            "logarithms; flagged as an outlier",
            lambda: naive_posterior(60.0, np.array([10.0, 20.0, 30.0]), 0.3),
            _our_posterior,
            _finite,
            _law,
        ),
        compare_once(
            "T5",
            "training peaks that are all equal",
            "25 times 1.0, 25 times 2.0; then 1.2",
            "sd = 0",
            "floor of the sensor and Student's t",
            _naive_cells,
            _our_cells,
            lambda found: _finite(found) and float(found[0]) > 0.9,
            _law,
        ),
        compare_once(
            "T6",
            "a level that was never left, and the end of a trial",
            "trials 0 1 0 1 and 2 2 over four levels",
            "trials joined, relative frequencies",
            "trials apart, Dirichlet prior",
            _naive_chain,
            _our_chain,
            _is_chain,
            _law,
        ),
    ]
