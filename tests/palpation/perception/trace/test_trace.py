"""Whole traces: bins, textures and training, the filter over them, and the belief along a sweep."""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palp_core.errors import MethodError, PerceptionError
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.trace.belief import (
    begin_sweep,
    fit_probability,
    observe,
    observe_stepwise,
    start,
)
from palp_core.palpation.perception.trace.bins import BinnedSweep, PositionBins
from palp_core.palpation.perception.trace.filters import DepthGrid, TraceKnowledge, model_of
from palp_core.palpation.perception.trace.model import Stays, SweepOf, TraceModel
from palp_core.palpation.perception.trace.texture import Texture, fit_texture
from palp_core.palpation.perception.trace.training import TrainedTraces, learn, shrunk_covariance, sticking
from palp_core.palpation.session.method_choices import PUBLISHED, chosen_method
from palp_core.units import Float64Array

PATH = PositionBins.over(-0.03, 0.05, 0.002)
MIDDLE_M = np.asarray(-0.03 + 0.002 * (np.arange(PATH.count) + 0.5), dtype=np.float64)


@given(st.lists(st.integers(0, 4000), max_size=8), st.booleans())
def test_blocks_give_the_bins_of_the_whole(cuts: list[int], backward: bool) -> None:
    position = np.asarray(-0.03 + 2e-5 * np.arange(4000), dtype=np.float64)
    bins = PATH
    if backward:
        position, bins = position[::-1], PositionBins.over(position[-1], -0.03, 0.002)
    torque = np.sin(position * 300.0) + 0.01 * np.random.default_rng(1).standard_normal(4000)
    whole, sweep = BinnedSweep(), BinnedSweep()
    whole.add(bins, position, torque)
    whole.finish(bins)
    ends = [0, *sorted(cuts), 4000]
    for low, high in itertools.pairwise(ends):
        sweep.add(bins, position[low:high], torque[low:high])
    sweep.finish(bins)
    assert whole.done == sweep.done
    assert len(whole.done) == bins.count
    index = bins.index(position)
    np.testing.assert_allclose(whole.done, [torque[index == b].mean() for b in range(bins.count)], rtol=1e-12)


def test_a_bin_without_a_sample_lies_between_its_neighbours() -> None:
    sweep = BinnedSweep()
    sweep.add(PATH, np.array([-0.0299, -0.0285, -0.0235]), np.array([1.0, 3.0, 5.0]))
    assert sweep.done == [2.0, 4.0, 4.0]


def test_bad_bins_and_samples_are_refused() -> None:
    for wrong in ((0.0, 0.0, 3), (0.0, np.nan, 3), (0.0, 0.002, 0)):
        with pytest.raises(PerceptionError):
            PositionBins(*wrong)
    with pytest.raises(PerceptionError, match="NaN"):
        BinnedSweep().add(PATH, np.array([0.0]), np.array([np.nan]))
    with pytest.raises(PerceptionError, match="2 positions for 1"):
        BinnedSweep().add(PATH, np.array([0.0, 0.1]), np.array([0.0]))


@pytest.mark.parametrize(
    ("form", "sd_n_m", "length_m"), [("exponential", 1.9896e-4, 4.734e-3), ("gaussian", 1.9522e-4, 5.016e-3)]
)
def test_the_texture_of_residuals_is_found_again(form: str, sd_n_m: float, length_m: float) -> None:
    """What 30 rows tell of a spread of 2e-4 and a length of 5e-3."""
    rng, true = np.random.default_rng(2), Texture(2e-4, 5e-3, form)
    place = MIDDLE_M
    slope = np.broadcast_to(np.cos(place * 60.0)[:, None], (30, len(place), 1))
    covariance = true.covariance(place, place) + 1e-10 * np.eye(len(place))
    rows = rng.multivariate_normal(np.zeros(len(place)), covariance, 30)
    rows += slope[:, :, 0] * rng.normal(0.0, 1e-3, (30, 1))
    found = fit_texture(rows, slope, np.array([1e-3]), 1e-10 * np.eye(len(place)), np.tile(place, (30, 1)))
    assert found.form == form
    assert (found.sd_n_m, found.length_m) == pytest.approx((sd_n_m, length_m), rel=2e-3)


def test_training_teaches_the_mean_of_mountings_and_the_scatter_without_the_landing() -> None:
    rng = np.random.default_rng(3)
    place = MIDDLE_M
    shape = np.exp(-((place / 0.01) ** 2))
    depths, rings = (0.002, 0.004), (0.0, 0.004, 0.008)
    rows, depth, ring, mounting = [], [], [], []
    for d in depths:
        for mount in range(3):
            height = rng.normal(0.0, 1e-4)
            for r in rings:
                for _ in range(20):
                    landed = r + rng.normal(0.0, 1.7e-4)
                    signal = (0.1 / (1.0 + 1e3 * d)) * landed * shape + height * shape
                    rows.append(signal + rng.normal(0.0, 2e-6, len(place)))
                    depth.append(d)
                    ring.append(r)
                    mounting.append(mount + int(1e4 * d))
    learnt = learn(np.array(rows), depth, ring, mounting, floor_n_m=1e-9)
    noise = np.diagonal(learnt.scatter, axis1=1, axis2=2)
    np.testing.assert_allclose(noise.mean(axis=1), 4e-12, rtol=0.1)
    off = learnt.scatter - noise[:, :, None] * np.eye(PATH.count)
    assert np.abs(off).max() < 1e-12
    assert learnt.mountings.tolist() == [3, 3]
    assert learnt.landings.tolist() == [[60] * 3] * 2
    assert learnt.between.shape == (6, 3, PATH.count)
    wanted = np.array([[(0.1 / (1.0 + 1e3 * d)) * r * shape for r in rings] for d in depths])
    np.testing.assert_allclose(learnt.mean, wanted, atol=3e-4)
    steep = np.array([0.1 / (1.0 + 1e3 * d) for d in depths])[:, None, None] * shape
    np.testing.assert_allclose(learnt.ring_slope, np.broadcast_to(steep, learnt.mean.shape), atol=2e-3)


def test_a_cell_without_a_sweep_is_named() -> None:
    with pytest.raises(PerceptionError, match="depth 4 mm and ring 8 mm"):
        learn(np.zeros((3, 5)), [0.002, 0.002, 0.004], [0.004, 0.008, 0.004], [1, 1, 2], floor_n_m=1e-6)


def test_a_covariance_of_few_rows_keeps_what_is_no_chance() -> None:
    rng = np.random.default_rng(8)
    true = 0.9 ** np.abs(np.subtract.outer(np.arange(20), np.arange(20)))
    plain, drawn = [], []
    for _ in range(20):
        rows = rng.multivariate_normal(np.zeros(20), true, 30)
        rows = rows - rows.mean(axis=0)
        plain.append(np.linalg.norm(rows.T @ rows / 29 - true))
        drawn.append(np.linalg.norm(shrunk_covariance(rows, 29) - true))
    assert np.mean(drawn) < np.mean(plain)
    white = shrunk_covariance(rng.standard_normal((40, 20)), 40)
    assert np.abs(white - np.diag(np.diag(white))).max() < 0.1
    assert np.linalg.eigvalsh(shrunk_covariance(rng.standard_normal((5, 20)), 5)).min() > 0.0


def test_bins_in_which_a_tip_may_stick_are_not_read() -> None:
    place = np.concatenate([-0.03 + 1e-4 * np.arange(8), -0.028 + 2e-3 * np.arange(22)])
    held = sticking(np.tile(place, (2, 3, 1)))
    assert held.shape == (3, 30)
    assert held[0].tolist() == [True] * 9 + [False] * 21  # seven, and a quarter more
    assert not sticking(np.tile(MIDDLE_M, (2, 3, 1))).any()


DEPTHS_M, RINGS_M, PLACES = (0.002, 0.004, 0.008), (0.008, 0.016), 12
PLACE_M = np.arange(PLACES) * 2e-3
NOISE_N_M = 3e-5
LANDING = "ring_m"
SD = {LANDING: 1e-4, "height": 2e-4, "friction": 0.1}


def touch(offsets: Mapping[str, float], depths_m: tuple[float, ...] = DEPTHS_M) -> Float64Array:
    """A bump the higher the shallower, a straight answer to the height, a curved one to the friction."""
    height, friction = offsets.get("height", 0.0), offsets.get("friction", 0.0)
    landing = offsets.get(LANDING, 0.0)
    bump = np.exp(-(((PLACE_M - 0.012) / 0.004) ** 2))
    peak = (5.5e-3 - 0.25 * np.array(depths_m))[:, None, None] * (1.0 + 0.4 * friction + 2.0 * friction**2)
    base = 0.6 * (np.array(RINGS_M) + landing)[None, :, None]
    return np.asarray(peak * bump + base + 2.0 * height)


def known(names: tuple[str, ...] = tuple(SD), depths_m: tuple[float, ...] = DEPTHS_M) -> TraceKnowledge:
    """What the touch answers, by differences over a standard deviation."""
    sd = np.array([SD[name] for name in names])
    slope, bend = [], []
    for name, step in zip(names, sd, strict=True):
        up, down = touch({name: step}, depths_m), touch({name: -step}, depths_m)
        slope.append((up - down) / (2.0 * step))
        bend.append((up + down - 2.0 * touch({}, depths_m)) / (2.0 * step**2))
    stays: tuple[Stays, ...] = tuple("landing" if name == LANDING else "trial" for name in names)
    place_m = np.tile(PLACE_M, (len(depths_m), len(RINGS_M), 1))
    bends = np.stack(bend, -1)
    bends[np.abs(bends) * sd**2 < 1e-9] = 0.0  # rounding of what is straight
    return TraceKnowledge(
        sd,
        stays,
        touch({}, depths_m),
        np.stack(slope, -1),
        bends,
        0.0,
        Texture(1e-6),
        place_m,
    )


def trained() -> TrainedTraces:
    cells = [(d, r) for d in range(3) for r in range(2) for _ in range(20)]
    felt = np.array([touch({})[cell] for cell in cells])
    felt += np.random.default_rng(1).normal(0.0, NOISE_N_M, felt.shape)
    return learn(
        felt,
        [DEPTHS_M[d] for d, _ in cells],
        [RINGS_M[r] for _, r in cells],
        [d for d, _ in cells],
        floor_n_m=1e-6,
    )


def test_slopes_are_those_of_the_touch_and_count_against_training() -> None:
    model = model_of("second_order", trained(), known())
    twice = np.sqrt(2.0)  # one mounting a class: the offset counts against training's own
    np.testing.assert_allclose(model.slope[..., 1], 2.0 * twice, rtol=1e-9)
    bump = np.exp(-(((PLACE_M - 0.012) / 0.004) ** 2))
    np.testing.assert_allclose(model.slope[0, 0, :, 2], 0.4 * 5e-3 * bump * twice, rtol=1e-9)
    np.testing.assert_allclose(model.slope[..., 0], 0.6 * np.sqrt(1.0 + 1.0 / 20.0), rtol=1e-9)
    assert model.stays == ("landing", "trial", "trial", "trial")


def test_squares_of_offsets_are_offsets_whose_variance_is_that_of_the_touch() -> None:
    bent = model_of("second_order", trained(), known())
    assert len(bent.stays) == len(known().sd) + 1  # the friction squared
    frictions = SD["friction"] * np.random.default_rng(3).standard_normal(20000)
    top = np.array([touch({"friction": f})[0, 1, 6] for f in frictions])
    of_friction = [2, 3]
    spread = (bent.slope[0, 1, 6, of_friction] * bent.offset_sd[of_friction]) ** 2
    assert spread.sum() / 2.0 == pytest.approx(top.var(), rel=0.05)  # half of it is training's own mounting
    assert spread[0] / 2.0 < 0.9 * top.var()


def test_depths_between_are_the_mechanics_and_what_training_adds() -> None:
    depths_m = np.linspace(0.002, 0.008, 7)
    off = replace(trained(), mean=trained().mean + 1e-4)
    model = model_of("second_order", off, known(), DepthGrid(depths_m, known(depths_m=tuple(depths_m))))
    assert model.class_count == 7
    np.testing.assert_allclose(model.mean, touch({}, tuple(depths_m)) + 1e-4, atol=3e-5)
    np.testing.assert_allclose(model.mean[0], off.mean[0], rtol=1e-12)


def test_the_texture_is_that_of_trainings_mountings_where_there_are_several() -> None:
    rng, field = np.random.default_rng(6), Texture(2e-4, 3e-3)
    place_m = np.asarray(PLACE_M, dtype=np.float64)
    tracks = rng.multivariate_normal(
        np.zeros(PLACES), field.covariance(place_m, place_m) + 1e-14 * np.eye(PLACES), 24
    )
    cells = [(d, r, m) for d in range(3) for r in range(2) for m in range(8)]
    felt = np.array([touch({})[d, r] + tracks[8 * d + m] for d, r, m in cells])
    felt += rng.normal(0.0, 1e-6, felt.shape)
    several = learn(
        felt,
        [DEPTHS_M[d] for d, _, _ in cells],
        [RINGS_M[r] for _, r, _ in cells],
        [8 * d + m for d, _, m in cells],
        floor_n_m=1e-6,
    )
    model = model_of("second_order", several, known((LANDING,)))
    assert model.texture.sd_n_m == pytest.approx(1.048 * 2e-4 * np.sqrt(1.0 + 1.0 / 8.0), rel=2e-3)
    assert model.texture.length_m == pytest.approx(1.024 * 3e-3, rel=2e-3)
    assert model_of("second_order", trained(), known((LANDING,))).texture.sd_n_m == pytest.approx(
        1e-6 * np.sqrt(2.0)
    )


@pytest.mark.parametrize(("share", "good"), [(0.5, True), (1.0, True), (2.0, False), (4.0, False)])
def test_the_register_chooses_by_how_much_is_stated_to_differ(share: float, good: bool) -> None:
    spreads = ("trace_height_sd_m", "friction_sd", "modulus_sd", "place_sd_m", "tip_sd_m")
    given = {**PUBLISHED, **{one: share * PUBLISHED[one] for one in spreads}}
    if good:
        assert chosen_method("trace_filter", Scene(), given=given).name == "second_order"
    else:
        with pytest.raises(MethodError, match="no trace_filter method gives 'decision'"):
            chosen_method("trace_filter", Scene(), given=given)


BINS, SETTINGS, CLASSES = 9, 2, 3
STAYS: tuple[Stays, ...] = ("trial", "landing", "sweep")


def random_model(seed: int = 1, *, apart: float = 1.0) -> TraceModel:
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
    model, rng = random_model(), np.random.default_rng(2)
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
    model = random_model()
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
    model, rng = random_model(apart=0.25), np.random.default_rng(4)
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
    model, rng = random_model(apart=20.0), np.random.default_rng(5)
    felt, _ = drawn(model, 4000, rng)
    belief = observe(model, begin_sweep(start(model, len(felt)), 0, landed=True), felt)
    share = (fit_probability(belief) < 0.05).mean()
    assert share == pytest.approx(0.05, abs=0.014)
    bumped = felt.copy()
    bumped[:, 4] += 3e-3
    strange = observe(model, begin_sweep(start(model, len(felt)), 0, landed=True), bumped)
    assert (fit_probability(strange) < 0.05).mean() > 0.9


def test_a_sweep_that_was_not_begun_or_is_over_is_refused() -> None:
    model = random_model()
    with pytest.raises(PerceptionError, match="begin_sweep"):
        observe(model, start(model), np.zeros(2))
    belief = observe(model, begin_sweep(start(model), 0, landed=True), np.zeros(BINS))
    with pytest.raises(PerceptionError, match="10 bins"):
        observe(model, belief, np.zeros(1))
    with pytest.raises(PerceptionError, match="NaN"):
        observe(model, begin_sweep(belief, 0, landed=False), np.array([np.nan]))
    with pytest.raises(PerceptionError, match="not trained"):
        observe(model, begin_sweep(belief, 7, landed=False), np.zeros(1))
