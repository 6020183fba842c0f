"""The belief along a sweep: the joint normal density, in any order of computing it."""

import itertools

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.belief import (
    begin_sweep,
    fit_probability,
    observe,
    observe_stepwise,
    start,
)
from palp_core.palpation.perception.trace.model import Stays, SweepOf, TraceModel
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.units import Float64Array

BINS, SETTINGS, CLASSES = 9, 2, 3
STAYS: tuple[Stays, ...] = ("trial", "landing", "sweep")


def model_of(seed: int = 1, *, apart: float = 1.0) -> TraceModel:
    rng = np.random.default_rng(seed)
    place = np.tile(np.arange(BINS) * 2e-3, (CLASSES, SETTINGS, 1)) * (
        1.0 + 0.1 * np.arange(CLASSES)[:, None, None]
    )
    return TraceModel(
        apart * rng.normal(0.0, 1e-3, (CLASSES, SETTINGS, BINS)),
        rng.normal(0.0, 1.0, (CLASSES, SETTINGS, BINS, 3)),
        np.array([4e-4, 2e-4, 1e-4]),
        STAYS,
        np.tile(1e-8 * np.eye(BINS), (SETTINGS, 1, 1)),
        Texture(3e-4, 4e-3, "exponential"),
        place,
    )


def stacked(model: TraceModel, component: int, sweeps: list[SweepOf]) -> tuple[Float64Array, Float64Array]:
    """Mean and covariance of the torques of sweeps, written down entry by entry."""
    rows = [(one, number, i) for number, one in enumerate(sweeps) for i in range(one.bins)]
    mean = np.array([model.mean[component, one.setting, i] for one, _, i in rows])
    covariance = np.zeros((len(rows), len(rows)))
    for a, (one, n, i) in enumerate(rows):
        for b, (other, o, j) in enumerate(rows):
            for which, stays in enumerate(STAYS):
                if stays == "trial" or n == o or (stays == "landing" and one.landing == other.landing):
                    covariance[a, b] += (
                        model.slope[component, one.setting, i, which]
                        * model.slope[component, other.setting, j, which]
                        * model.offset_sd[which] ** 2
                    )
            apart = abs(model.place_m[component, one.setting, i] - model.place_m[component, other.setting, j])
            covariance[a, b] += 3e-4**2 * np.exp(-apart / 4e-3)
            covariance[a, b] += 1e-8 * (a == b)
    return mean, covariance


def test_innovations_make_the_density_of_all_torques_together() -> None:
    model, rng = model_of(), np.random.default_rng(2)
    plan = [SweepOf(0, 0, BINS), SweepOf(0, 0, 4), SweepOf(1, 1, BINS)]
    felt = [rng.normal(0.0, 1e-3, one.bins) for one in plan]
    belief = start(model)
    for number, (one, torque) in enumerate(zip(plan, felt, strict=True)):
        belief = begin_sweep(belief, one.setting, landed=number == 2)
        belief = observe(model, belief, torque[:3])
        belief = observe(model, belief, torque[3:])
    assert belief.sweeps == tuple(plan)
    everything = np.concatenate(felt)
    for component in range(CLASSES):
        mean, covariance = stacked(model, component, plan)
        known = scipy.stats.multivariate_normal(mean, covariance).logpdf(everything)
        assert belief.log_density[0, component] == pytest.approx(known, rel=1e-9)


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 20), st.lists(st.integers(0, BINS), max_size=4), st.integers(0, 2**31))
def test_many_at_once_and_one_by_one_in_blocks_are_the_same_to_the_last_bit(
    count: int, cuts: list[int], seed: int
) -> None:
    model = model_of()
    felt = np.random.default_rng(seed).normal(0.0, 1e-3, (count, 2, BINS))
    together, whole = start(model, count), []
    for number in range(2):
        together = begin_sweep(together, number, landed=True)
        together, found = observe_stepwise(model, together, felt[:, number])
        whole.append(found)
    ends = [0, *sorted(cuts), BINS]
    for trial in range(count):
        belief = start(model)
        for number in range(2):
            belief = begin_sweep(belief, number, landed=True)
            parts = []
            for low, high in itertools.pairwise(ends):
                belief, part = observe_stepwise(model, belief, felt[trial, number, low:high])
                parts.append(part[0])
            assert np.array_equal(np.concatenate(parts), whole[number][trial])
        assert np.array_equal(belief.log_density[0], together.log_density[trial])


def drawn(model: TraceModel, count: int, rng: np.random.Generator) -> tuple[Float64Array, NDArray[np.int64]]:
    """Whole first sweeps at setting 0 of random classes, drawn from the model by its definition."""
    truth = np.asarray(rng.integers(0, CLASSES, count), dtype=np.int64)
    felt = np.empty((count, BINS))
    for component in range(CLASSES):
        mean, covariance = stacked(model, component, [SweepOf(0, 0, BINS)])
        here = truth == component
        felt[here] = rng.multivariate_normal(mean, covariance, int(here.sum()))
    return felt, truth


def test_a_stated_probability_is_how_often_it_is_right() -> None:
    model, rng = model_of(apart=0.25), np.random.default_rng(4)
    felt, truth = drawn(model, 8000, rng)
    _, found = observe_stepwise(model, begin_sweep(start(model, len(felt)), 0, landed=True), felt)
    for bins in (3, BINS):
        posterior = found[:, bins - 1]
        stated, right = posterior.max(axis=1), posterior.argmax(axis=1) == truth
        for low, high in ((0.34, 0.6), (0.6, 0.8), (0.8, 0.95), (0.95, 1.0)):
            here = (stated >= low) & (stated < high)
            if here.sum() > 100:
                assert right[here].mean() == pytest.approx(
                    stated[here].mean(), abs=4.0 * 0.5 / here.sum() ** 0.5
                )


def test_a_fit_is_as_improbable_as_it_says() -> None:
    model, rng = model_of(apart=20.0), np.random.default_rng(5)
    felt, _ = drawn(model, 4000, rng)
    belief = observe(model, begin_sweep(start(model, len(felt)), 0, landed=True), felt)
    share = (fit_probability(belief) < 0.05).mean()
    assert share == pytest.approx(0.05, abs=0.014)
    bumped = felt.copy()
    bumped[:, 4] += 3e-3
    strange = observe(model, begin_sweep(start(model, len(felt)), 0, landed=True), bumped)
    assert (fit_probability(strange) < 0.05).mean() > 0.9


def test_a_sweep_that_was_not_begun_or_is_over_is_refused() -> None:
    model = model_of()
    with pytest.raises(PerceptionError, match="begin_sweep"):
        observe(model, start(model), np.zeros(2))
    belief = observe(model, begin_sweep(start(model), 0, landed=True), np.zeros(BINS))
    with pytest.raises(PerceptionError, match="10 bins"):
        observe(model, belief, np.zeros(1))
    with pytest.raises(PerceptionError, match="NaN"):
        observe(model, begin_sweep(belief, 0, landed=False), np.array([np.nan]))
    with pytest.raises(PerceptionError, match="not trained"):
        observe(model, begin_sweep(belief, 7, landed=False), np.zeros(1))
