"""Filters over traces: straight and over a grid, against touches whose answers are known."""

from collections.abc import Mapping

import numpy as np
import pytest

from palp_core.errors import MethodError, PerceptionError
from palp_core.methods import names
from palp_core.palpation.perception.trace.belief import begin_sweep, classes, observe, start
from palp_core.palpation.perception.trace.filters import NODES, TraceKnowledge, model_of
from palp_core.palpation.perception.trace.model import Stays, TraceModel
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.palpation.perception.trace.training import LANDING, TrainedTraces, learn
from palp_core.units import Float64Array

DEPTHS_M, RINGS_M, BINS = (0.002, 0.004, 0.008), (0.008, 0.016), 12
PLACE_M = np.arange(BINS) * 2e-3
NOISE_N_M = 3e-5
SD = {LANDING: 1e-4, "height": 2e-4, "friction": 0.1}


def touch(offsets: Mapping[str, float]) -> Float64Array:
    """A bump the higher the shallower, a straight answer to the height, a curved one to the friction."""
    height, friction = offsets.get("height", 0.0), offsets.get("friction", 0.0)
    bump = np.exp(-(((PLACE_M - 0.012) / 0.004) ** 2))
    peak = np.array([5e-3, 4.5e-3, 4e-3])[:, None, None] * (1.0 + 0.4 * friction + 2.0 * friction**2)
    base = 0.6 * np.array(RINGS_M)[None, :, None]
    return np.asarray(peak * bump + base + 2.0 * height)


def known(names: tuple[str, ...] = tuple(SD)) -> TraceKnowledge:
    """What the touch answers, by differences over a standard deviation."""
    sd = np.array([SD[name] for name in names])
    slope, bend = [], []
    for name, step in zip(names, sd, strict=True):
        up, down = touch({name: step}), touch({name: -step})
        slope.append((up - down) / (2.0 * step))
        bend.append((up + down - 2.0 * touch({})) / (2.0 * step**2))
    stays: tuple[Stays, ...] = tuple("landing" if name == LANDING else "trial" for name in names)
    place_m = np.tile(PLACE_M, (3, len(RINGS_M), 1))
    return TraceKnowledge(
        names,
        sd,
        stays,
        np.stack(slope, -1),
        np.stack(bend, -1),
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


def stated_and_right(model: TraceModel, count: int = 3000) -> tuple[float, float]:
    """How surely the most probable class is stated on average, and how often it is the true one."""
    rng = np.random.default_rng(2)
    truth = rng.integers(0, 3, count)
    frictions = SD["friction"] * np.sqrt(2.0) * rng.standard_normal(count)  # against training's own
    felt = np.array([touch({"friction": f})[d, 1] for d, f in zip(truth, frictions, strict=True)])
    felt += rng.normal(0.0, NOISE_N_M, felt.shape)
    belief = observe(model, begin_sweep(start(model, count), 1, landed=True), felt)
    found = classes(model, belief.log_density)
    return float(found.max(axis=1).mean()), float((found.argmax(axis=1) == truth).mean())


def test_slopes_are_those_of_the_touch_and_the_landings_of_training() -> None:
    model = model_of("linear", trained(), known(), np.array(DEPTHS_M))
    twice = np.sqrt(2.0)  # one mounting a class: the offset counts against training's own
    np.testing.assert_allclose(model.slope[..., 1], 2.0 * twice, rtol=1e-9)
    bump = np.exp(-(((PLACE_M - 0.012) / 0.004) ** 2))
    np.testing.assert_allclose(model.slope[0, 0, :, 2], 0.4 * 5e-3 * bump * twice, rtol=1e-9)
    np.testing.assert_allclose(model.slope[..., 0], 0.6 * np.sqrt(1.0 + 1.0 / 20.0), rtol=0.05)
    assert model.stays == ("landing", "trial", "trial")


def test_the_grid_is_over_the_offset_with_the_most_curved_answer_and_beats_the_line_there() -> None:
    straight = model_of("linear", trained(), known(), np.array(DEPTHS_M))
    nodes = model_of("grid", trained(), known(), np.array(DEPTHS_M))
    assert known().names[known().most_curved()] == "friction"
    assert len(nodes.class_of) == NODES * len(straight.class_of)
    (of_line, line_right), (of_grid, grid_right) = stated_and_right(straight), stated_and_right(nodes)
    assert abs(of_grid - grid_right) < abs(of_line - line_right)
    assert grid_right > line_right


def test_depths_between_the_trained_ones_are_interpolated() -> None:
    depths_m = np.linspace(0.002, 0.008, 7)
    model = model_of("linear", trained(), known(), depths_m)
    assert model.class_count == 7
    np.testing.assert_allclose(model.mean[0], trained().mean[0], rtol=1e-12)
    np.testing.assert_allclose(model.mean[-1], trained().mean[-1], rtol=1e-12)
    assert (np.diff(model.mean[:, 1, 6]) < 0.0).all()


def test_what_it_cannot_know_is_said() -> None:
    assert set(names("trace_filter")) >= {"linear", "grid"}
    with pytest.raises(MethodError, match="no method 'magic'"):
        model_of("magic", trained(), known(), np.array(DEPTHS_M))
    with pytest.raises(PerceptionError, match="a grid needs an offset"):
        model_of("grid", trained(), known((LANDING,)), np.array(DEPTHS_M))
