"""The filter over traces, against touches whose answers are known."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import MethodError
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.trace.filters import DepthGrid, TraceKnowledge, model_of
from palp_core.palpation.perception.trace.model import Stays
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.palpation.perception.trace.training import TrainedTraces, learn
from palp_core.palpation.session.method_choices import PUBLISHED, chosen_method
from palp_core.units import Float64Array

DEPTHS_M, RINGS_M, BINS = (0.002, 0.004, 0.008), (0.008, 0.016), 12
PLACE_M = np.arange(BINS) * 2e-3
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
        np.zeros(BINS), field.covariance(place_m, place_m) + 1e-14 * np.eye(BINS), 24
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
def test_the_register_goes_by_how_much_is_told_to_differ(share: float, good: bool) -> None:
    spreads = ("trace_height_sd_m", "friction_sd", "modulus_sd", "place_sd_m", "tip_sd_m")
    given = {**PUBLISHED, **{one: share * PUBLISHED[one] for one in spreads}}
    if good:
        assert chosen_method("trace_filter", Scene(), given=given).name == "second_order"
    else:
        with pytest.raises(MethodError, match="no trace_filter method gives 'decision'"):
            chosen_method("trace_filter", Scene(), given=given)


def test_an_unknown_filter_is_refused() -> None:
    with pytest.raises(MethodError, match="no method 'magic'"):
        model_of("magic", trained(), known())
