"""Cases T1 to T11: the published algorithm as printed, on the smallest input at which it fails."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pywt
from scipy.spatial.distance import correlation

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import bayes, latent
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.stopping import BeliefStep, PaperGuarded, PaperVerbatim, StopRule
from palp_core.palpation.perception.emg.emg import EmgChain, find_offset
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.signal.features import peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.statistics.anova import NotTestable, two_way
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.perception.strategy.policies import MarkovPolicy
from palp_core.palpation.studies.stability.case import Case
from palp_core.units import Float64Array

FLAT = np.full(3, 1 / 3)
LIMIT = 0.0005
GOES_ON = "goes on"
Posteriors = tuple[tuple[float, ...], ...]


def naive_gain(posterior: Float64Array, prior: Float64Array) -> Float64Array:
    """Return eq. (8) as printed."""
    return np.asarray(posterior * np.log(posterior / prior))


def naive_stop(posteriors: Sequence[Float64Array]) -> str:
    """Return whether the loop of Algorithm 1 ends, as printed: it goes on while gamma > T, from G_0 = 0."""
    prior = np.full(posteriors[0].size, 1.0 / posteriors[0].size)
    before = naive_gain(posteriors[-2], prior) if len(posteriors) > 1 else np.zeros(posteriors[0].size)
    return GOES_ON if correlation(before, naive_gain(posteriors[-1], prior)) > LIMIT else "stops"


def rule_stop(rule: StopRule, posteriors: Sequence[Float64Array]) -> str:
    """Return whether a rule stops."""
    prior = np.full(posteriors[0].size, 1.0 / posteriors[0].size)
    gains = [gain_vector(p, prior) for p in posteriors]
    return "stops" if rule.check(BeliefStep.last(posteriors, gains)).converged else GOES_ON


def _stop_case(
    name: str,
    symptom: str,
    scene: str,
    posteriors: Posteriors,
    *,
    method: str,
    survivor: str,
    rule: StopRule | None = None,
    right: Callable[[Any], bool] = lambda found: found == GOES_ON,
) -> Case:
    """Return a case of stopping: the printed loop against ours, or ours against another rule."""
    steps, ours = [np.array(one) for one in posteriors], PaperVerbatim()
    naive = (lambda: naive_stop(steps)) if rule is None else (lambda: rule_stop(ours, steps))
    return Case(name, method, survivor, scene, symptom, naive, lambda: rule_stop(rule or ours, steps), right)


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


def _is_chain(found: Any) -> bool:
    """Whether it is a chain in which a level that was never left is left now and then."""
    return _finite(found) and bool(np.allclose(np.sum(found, axis=0), 1.0)) and bool(found[2, 1] < 0.2)


ONE_HOT = np.array([1.0, 0.0, 0.0])
BLOCKS = np.array([[0.9, 0.1, 0.0, 0.0], [0.1, 0.9, 0.0, 0.0], [0.0, 0.0, 0.5, 0.5], [0.0, 0.0, 0.5, 0.5]])
CYCLE = np.roll(np.eye(3), 1, axis=0)


def _naive_stationary() -> Float64Array:
    values, vectors = np.linalg.eig(BLOCKS)
    vector = vectors[:, int(np.argmax(np.abs(values)))].real
    return np.asarray(vector / vector.sum())


def _wave(signal: Float64Array, mode: str) -> Float64Array:
    parts = pywt.wavedec(signal, "db10", mode=mode, level=5)
    return np.asarray(pywt.waverec([parts[0], *[np.zeros_like(p) for p in parts[1:]]], "db10", mode=mode))


SHORT = np.sin(np.arange(500) / 50.0)
BUMP = 10.0 + 0.5 * np.exp(-0.5 * ((np.arange(4001.0) - 2000.0) / 150.0) ** 2)
"""A bump at the middle of a constant torque."""
STEP = np.repeat([0.0, 1.0], 2000)


def naive_peak() -> int:
    """Return the sample of the largest value of a bump that is padded with zeros."""
    return int(np.argmax(_wave(BUMP, "zero")))


def _visited(reading: str) -> int:
    policy = MarkovPolicy(reading=reading)  # type: ignore[arg-type]
    rng, flat = np.random.default_rng(0), latent.of_classes(np.full(3, 1 / 3))
    at = policy.start(rng.random)
    levels = []
    for _ in range(40):
        at = policy.step(at, flat, rng.random)
        levels.append(int(at.level))
    return len(set(levels[5:]))


def printed_law() -> Float64Array:
    """Return eq. (5) as printed, with the sign of its exponent."""
    levels = np.asarray(figure5.LEVELS)
    weights = np.exp((levels - 0.3) ** 2 / (2.0 * 0.08**2))
    return np.asarray(weights / weights.sum())


def _counts() -> Float64Array:
    """Return a second of rest and a second of effort in counts of a 12-bit converter."""
    rng = np.random.default_rng(0)
    return np.asarray(np.round(2040.0 + rng.normal(0.0, 1.0, 3000) * np.repeat([2.0, 100.0], 1500)))


def _effort(envelope: Float64Array) -> float:
    return float(envelope[2000:2800].mean() / envelope[200:1200].mean())


def _naive_envelope() -> float:
    return _effort(np.sqrt(np.convolve(_counts() ** 2, np.full(75, 1 / 75), mode="valid")))


def _our_envelope() -> float:
    counts = _counts()
    chain = EmgChain(offset=find_offset(counts[:1500]), rate_hz=1500.0)
    return _effort(chain.step(chain.start(), counts)[1])


HIGH = np.array([0.02, 0.3, 0.71])


def naive_levels() -> Float64Array:
    """Return levels by an index that is not clamped."""
    index = np.round((HIGH - 0.1) / 0.1).astype(int)
    return np.asarray(np.array(figure5.LEVELS)[index])


def _our_levels() -> tuple[list[int], int]:
    found = to_levels(HIGH)
    return found.index.tolist(), found.clamped_low_count + found.clamped_high_count


def _naive_anova() -> str:
    import pandas as pd
    import statsmodels.formula.api as formulas  # type: ignore[import-untyped]
    from statsmodels.stats.anova import anova_lm  # type: ignore[import-untyped]

    data = pd.DataFrame({"y": np.full(30, 0.1), "a": list("abc") * 10, "b": list("de") * 15})
    table = anova_lm(formulas.ols("y ~ C(a) * C(b)", data=data).fit(), typ=2)
    return f"p = {table['PR(>F)'].iloc[0]:.2g}"


def _our_anova() -> str:
    found = two_way(np.full(30, 0.1), list("abc") * 10, list("de") * 15, names=("a", "b"))
    return f"not testable: {found.reason}" if isinstance(found, NotTestable) else "a table"


def _refused(found: Any) -> bool:
    return isinstance(found, PerceptionError)


CASES = (
    _stop_case(
        "T1",
        "gamma at the first probe",
        "P_1 = [0.6, 0.3, 0.1], G_0 = 0",
        ((0.6, 0.3, 0.1),),
        method="`while gamma > T`: undefined ends the loop",
        survivor="undefined is not converged",
    ),
    Case(
        "T1b",
        "P log(P / P_0)",
        "0 log 0 = 0",
        "P = [1, 0, 0]",
        "a belief that is certain",
        lambda: naive_gain(ONE_HOT, FLAT),
        lambda: gain_vector(ONE_HOT, FLAT),
        _finite,
    ),
    _stop_case(
        "T1c",
        "probes without information",
        "P_1 = P_2 = P_0",
        ((1 / 3, 1 / 3, 1 / 3),) * 2,
        method="correlation of two zero vectors",
        survivor="no stop on a gain without variance",
    ),
    _stop_case(
        "T2",
        "two depths",
        "P_1 = [0.51, 0.49], P_2 = [0.52, 0.48]",
        ((0.51, 0.49), (0.52, 0.48)),
        method="the distance is 0: stops on next to nothing",
        survivor="refused, alternatives named",
        right=lambda found: _refused(found) and "posterior_threshold" in str(found),
    ),
    _stop_case(
        "T3",
        "a belief that grows along one direction",
        "[0.4, 0.3, 0.3], then [0.9, 0.05, 0.05]",
        ((0.4, 0.3, 0.3), (0.9, 0.05, 0.05)),
        method="the published rule",
        survivor="`paper_guarded`: the posterior must have settled too",
        rule=PaperGuarded(),
    ),
    Case(
        "T4",
        "densities multiplied",
        "logarithms; flagged as an outlier",
        "60 against means 10, 20, 30 with sd 0.3",
        "an outlier",
        lambda: naive_posterior(60.0, np.array([10.0, 20.0, 30.0]), 0.3),
        _our_posterior,
        _finite,
    ),
    Case(
        "T5",
        "sd = 0",
        "floor of the sensor and Student's t",
        "25 times 1.0, 25 times 2.0; then 1.2",
        "training peaks that are all equal",
        _naive_cells,
        _our_cells,
        lambda found: _finite(found) and float(found[0]) > 0.9,
    ),
    Case(
        "T6",
        "trials joined, relative frequencies",
        "trials apart, Dirichlet prior",
        "trials 0 1 0 1 and 2 2 over four levels",
        "a level that was never left, and the end of a trial",
        _naive_chain,
        lambda: markov.transition_matrix(markov.count_transitions(VISITS, 4)),
        _is_chain,
    ),
    Case(
        "T7",
        "the leading eigenvector, whichever it is",
        "refused: two closed classes",
        "block-diagonal matrix",
        "a chain in two parts",
        _naive_stationary,
        lambda: markov.stationary(BLOCKS),
        _refused,
    ),
    Case(
        "T7b",
        "1 / (1 - second largest real part)",
        "refused: period 3",
        "cyclic permutation of three levels",
        "a chain that goes in circles",
        lambda: float(1.0 / (1.0 - np.sort(np.linalg.eigvals(CYCLE).real)[-2])),
        lambda: markov.relaxation_time(CYCLE),
        _refused,
    ),
    Case(
        "T8",
        "the library warns and goes on",
        "refused: 608 samples at least",
        "500 samples, db10",
        "a signal too short for five levels",
        lambda: _wave(SHORT, "symmetric").size,
        lambda: denoise(SHORT).size,
        _refused,
        answer="{} samples",
    ),
    Case(
        "T8b",
        "zero padding, the largest value of all",
        "symmetric extension, no peak from inside the edge cone",
        "10, with a bump of 0.5 at sample 2000",
        "the boundary",
        naive_peak,
        lambda: peak(denoise(BUMP), edge=edge_cone()).index,
        lambda found: not isinstance(found, Exception) and abs(found - 2000) < 20,
        answer="a peak at sample {}",
    ),
    Case(
        "T8c",
        "approximation only",
        "soft universal threshold, named in the record",
        "a unit step",
        "the rule for the coefficients",
        lambda: float(denoise(STEP, rule="approximation")[600:-600].max() - 1.0),
        lambda: float(denoise(STEP)[600:-600].max() - 1.0),
        lambda found: not isinstance(found, Exception) and found < 0.02,
        answer="an overshoot of {}",
    ),
    Case(
        "T9",
        "the mean, never a draw",
        "draws from the column",
        "40 steps of the chain",
        "eqs. (4) and (5) taken literally",
        lambda: _visited("mean"),
        lambda: _visited("column"),
        lambda found: not isinstance(found, Exception) and found >= 3,
        answer="{} level(s) visited after the fifth step",
    ),
    Case(
        "T9c",
        "exp(+x^2 / 2 sigma^2)",
        "exp(-x^2 / 2 sigma^2)",
        "mean 0.3, sd 0.08",
        "eq. (5) as printed",
        printed_law,
        lambda: MarkovPolicy().level_law(0.3),
        lambda found: not isinstance(found, Exception) and int(np.argmax(found)) == 2,
    ),
    Case(
        "T10",
        "RMS of the counts",
        "offset removed first",
        "a 12-bit converter at 2040 counts, effort 50 times rest",
        "the offset of the electrodes",
        _naive_envelope,
        _our_envelope,
        lambda found: not isinstance(found, Exception) and 40.0 < found < 60.0,
        answer="effort {} times rest",
    ),
    Case(
        "T10b",
        "(s - 0.1) / 0.1 as an index",
        "clamped, and counted",
        "0.02, 0.3 and 0.71",
        "co-contraction beyond the levels",
        naive_levels,
        _our_levels,
        lambda found: found == ([0, 2, 4], 2),
    ),
    Case(
        "T11",
        "statsmodels as it is",
        "not testable, with the reason",
        "30 outcomes of 0.1",
        "variance analysis of a constant",
        _naive_anova,
        _our_anova,
        lambda found: str(found).startswith("not testable"),
    ),
)
