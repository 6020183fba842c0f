"""Trials and training's mountings as they are held against each other, on touches whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.methods import find
from palp_core.palpation.perception.belief.session_check import MISFIT, Projected, SessionTrials, shifted
from palp_core.palpation.perception.trace.belief import TraceBelief, begin_sweep, cut, observe, start
from palp_core.palpation.perception.trace.check import projected
from palp_core.palpation.perception.trace.filters import model_of
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.training import TrainedTraces, learn
from palp_core.units import Float64Array
from tests.palpation.perception.trace.test_filters import (
    BINS,
    DEPTHS_M,
    NOISE_N_M,
    RINGS_M,
    known,
    touch,
)

NAMES = ("height", "friction")


def mounted(rng: np.random.Generator, spread: float, **more: float) -> Float64Array:
    """A touch of a mounting, all cells, its height and friction drawn."""
    drawn = {"height": rng.normal(0.0, 2e-4 * spread), "friction": rng.normal(0.0, 0.05 * spread)}
    return touch({name: value + more.get(name, 0.0) for name, value in drawn.items()})


def trained(rng: np.random.Generator, mountings: int, spread: float = 1.0) -> TrainedTraces:
    felt, depth, ring, number = [], [], [], []
    for d in range(3):
        for m in range(mountings):
            own = mounted(rng, spread)
            for r in range(2):
                for _ in range(4):
                    felt.append(own[d, r] + rng.normal(0.0, NOISE_N_M, BINS))
                    depth.append(DEPTHS_M[d])
                    ring.append(RINGS_M[r])
                    number.append(d * mountings + m)
    return learn(np.array(felt), depth, ring, number, floor_n_m=1e-6)


def touched(rng: np.random.Generator, count: int, of: int, **more: float) -> Float64Array:
    felt = np.array([mounted(rng, 1.0, **more)[of, 1] for _ in range(count)])
    return felt + rng.normal(0.0, NOISE_N_M, felt.shape)


def belief_of(model: TraceModel, felt: Float64Array) -> TraceBelief:
    return observe(model, begin_sweep(start(model, len(felt)), 1, landed=True), felt)


def believed(model: TraceModel, rng: np.random.Generator, count: int, of: int, **more: float) -> TraceBelief:
    return belief_of(model, touched(rng, count, of, **more))


def test_trials_and_mountings_are_of_one_law_whatever_the_filter_takes_for_granted() -> None:
    """Ratios near 1 and a difference near 0: as near as so few mountings come."""
    rng, told = np.random.default_rng(1), known(NAMES)
    wanted = {
        "linear": (0.9462, 1.2092, 0.1125),
        "second_order": (0.9462, 1.2094, 0.1122),
        "grid": (0.9461, 1.2070, 0.1153),
    }
    held: dict[str, list[Projected]] = {name: [] for name in wanted}
    for _ in range(30):
        taught, felt = trained(rng, 4), touched(rng, 20, 1)
        for name in wanted:
            model = find("trace_filter", name).target(taught, told)
            held[name].append(projected(model, taught, belief_of(model, felt), 1))
            assert held[name][-1].names == (*NAMES, MISFIT)
    for name, (height, friction, misfit) in wanted.items():
        trials = np.concatenate([one.felt for one in held[name]])
        own = np.concatenate([one.taught for one in held[name]])
        # a trial is held against the mean of four, of which each has a part itself
        ratio = trials.var(axis=0)[:2] / (own.var(axis=0)[:2] * (5.0 / 3.0))
        assert ratio == pytest.approx([height, friction], abs=1e-3)
        assert trials[:, 2].mean() - own[:, 2].mean() == pytest.approx(misfit, abs=1e-3)


def test_a_difference_of_all_trials_is_told_by_its_name() -> None:
    rng = np.random.default_rng(2)
    taught = trained(rng, 3, 0.3)
    model = model_of("second_order", taught, known(NAMES))
    for more, name in (({"friction": 0.2}, "friction"), ({"height": -1e-3}, "height")):
        trials = SessionTrials()
        one: Projected | None = None
        for of in range(3):
            one = projected(model, taught, believed(model, rng, 10, of, **more), of)
            for row in range(10):
                trials.add(one, f"{of} {row}", row)
        assert one is not None
        found = shifted(trials, one)
        assert found is not None
        assert (found.name, found.p < 0.03) == (name, True)
        assert np.sign(found.scores) == np.sign(more[name])


def test_a_sweep_in_part_and_several_sweeps_are_held_against_mountings_swept_alike() -> None:
    rng = np.random.default_rng(3)
    taught = trained(rng, 3)
    model = model_of("linear", taught, known(NAMES))
    whole = believed(model, rng, 5, 0)
    part = projected(model, taught, cut(model, whole, 4), 0)
    assert part.felt.shape == (5, 3)
    assert part.taught.shape == (3, 3)
    twice = observe(model, begin_sweep(whole, 0, landed=True), np.tile(touch({})[0, 0], (5, 1)))
    assert projected(model, taught, twice, 0).taught.shape == (3, 3)
    alone = trained(rng, 1)
    assert projected(model_of("linear", alone, known(NAMES)), alone, whole, 0).taught.shape == (0, 3)
