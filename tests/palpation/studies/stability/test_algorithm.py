"""The naive formula, put into the library in place of ours, fails: the cases see it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import correlation

from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.stopping import BeliefStep, PaperGuarded, PaperVerbatim, StopState
from palp_core.palpation.perception.emg.emg import EmgChain
from palp_core.palpation.perception.signal.wavelet import denoise
from palp_core.palpation.perception.strategy import markov
from palp_core.palpation.perception.strategy.policies import MarkovPolicy
from palp_core.palpation.studies.stability import algorithm
from palp_core.palpation.studies.stability.case import Case
from palp_core.units import Float64Array


def loop_of_algorithm_1(self: Any, step: BeliefStep) -> StopState:
    gamma = float(correlation(step.gain_before, step.gain))
    return StopState(np.asarray(gamma), converged=np.asarray(not gamma > self.threshold))


def densities_multiplied(self: Primitives, reading: float, setting_index: int, **_: Any) -> Float64Array:
    z = (reading - self.mean[:, setting_index]) / self.sd[:, setting_index]
    return np.asarray(np.log(np.exp(-0.5 * z * z)))


def relative_frequencies(counts: Float64Array, **_: Any) -> Float64Array:
    return np.asarray(counts / counts.sum(axis=0))


def without_a_floor(*values: Any, floor: float, **names: Any) -> Primitives:
    return Primitives(**{**vars(FIT(*values, floor=floor, **names)), "sd": np.zeros((2, 1)), "floor": 1e-300})


def rms_of_the_counts(self: EmgChain, state: Any, counts: Float64Array) -> tuple[Any, Float64Array]:
    return state, np.sqrt(np.convolve(counts**2, np.full(75, 1 / 75), mode="same"))


FIT = fit

MUTATIONS: dict[str, tuple[Any, str, Any]] = {
    "T1": (PaperVerbatim, "check", loop_of_algorithm_1),
    "T1b": (algorithm, "gain_vector", algorithm.naive_gain),
    "T1c": (PaperVerbatim, "check", loop_of_algorithm_1),
    "T2": (PaperVerbatim, "check", loop_of_algorithm_1),
    "T3": (PaperGuarded, "check", lambda self, step: PaperVerbatim(self.threshold).check(step)),
    "T4": (Primitives, "log_likelihood", densities_multiplied),
    "T5": (algorithm, "fit", without_a_floor),
    "T6": (markov, "transition_matrix", relative_frequencies),
    "T7": (markov, "stationary", lambda matrix: np.real(np.linalg.eig(matrix)[1][:, 0])),
    "T7b": (markov, "relaxation_time", lambda matrix: 1.0),
    "T8": (algorithm, "denoise", lambda values, **_: np.asarray(values)),
    "T8b": (algorithm, "peak", lambda *_, **__: SimpleNamespace(index=algorithm._naive_peak())),
    "T8c": (algorithm, "denoise", lambda values, **_: denoise(values, rule="approximation")),
    "T9": (algorithm, "MarkovPolicy", lambda **_: MarkovPolicy(reading="mean")),
    "T9c": (MarkovPolicy, "level_law", lambda self, mean: algorithm._printed_law()),
    "T10": (EmgChain, "step", rms_of_the_counts),
    "T10b": (algorithm, "to_levels", lambda high: algorithm._naive_levels()),
    "T11": (algorithm, "two_way", lambda *_, **__: 0.0005),
}


def cases() -> dict[str, Case]:
    return {case.name: case for case in algorithm.algorithm_cases()}


def test_the_naive_method_fails_ours_survives_and_each_has_its_formula_here() -> None:
    found = cases()
    assert set(found) == set(MUTATIONS)
    assert [name for name, case in found.items() if not case.survived or not case.failed.all()] == []


@pytest.mark.parametrize("name", MUTATIONS)
def test_the_naive_formula_in_the_library_would_be_noticed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    where, attribute, naive = MUTATIONS[name]
    monkeypatch.setattr(where, attribute, naive)
    assert not cases()[name].survived
