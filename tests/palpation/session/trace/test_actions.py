"""Actions after training at one indentation and in one direction: foretold sweeps against true ones."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from nodes.safety import SafetyParams
from palp_core.errors import PerceptionError
from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.trace.actions import ActionModel, LoadLimits, SweepAction
from palp_core.palpation.perception.trace.belief import begin_sweep, observe, start
from palp_core.palpation.perception.trace.training import TrainedTraces, learn, sticking
from palp_core.palpation.session.trace.actions import STOP, ActionSet, action_model, expected_torque_n_m
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.palpation.world.drag import drag
from palp_core.palpation.world.latents import LATENTS, latents
from palp_core.palpation.world.model import LAB
from palp_core.palpation.world.slopes import binned, bins_of
from palp_core.palpation.world.texture import texture, texture_map, track
from palp_core.palpation.world.touch import touch
from palp_core.units import Float64Array

DEPTHS_M, RINGS_M = (0.002, 0.004, 0.008), (0.012, 0.016)
SETTINGS = TraceSettings(from_m=-0.026, to_m=0.034, run_in=True)
HOME = (-0.026, 0.034)
FORWARD = [SweepAction(r, 0.004, 0.02, *HOME) for r in RINGS_M]
DEEPER = SweepAction(0.016, 0.0045, 0.02, *HOME)
BACK = SweepAction(0.016, 0.004, 0.02, 0.034, -0.026)
LATER = SweepAction(0.016, 0.004, 0.02, -0.016, 0.034)
OFF = {"modulus": 0.08, "height_m": 0.2e-3, "friction": 0.06}
"""What the rig is off by in training and trials: about a spread of what a lab states beforehand."""


def swept(
    depth_m: float, action: SweepAction, rows: Float64Array, tracks: Float64Array | None = None
) -> Float64Array:
    """Torques against the sweep, solved for, in the bins of an action of 60 mm, shape (n, 30).

    With the surface of a lab where tracks are given.
    """
    scene = Scene().with_bead(depth_m).read_by("trace")
    low_m, high_m = sorted((action.from_m, action.from_m + action.sign * 0.06))
    bins = bins_of(np.linspace(low_m, high_m, 31), forward=not action.backward)
    contact = touch(scene.phantom, scene.probe, choose_rung(scene).rung)
    found = drag(contact, rows, np.full(len(rows), action.ring_m), action.indentation_m, bins.node_m)
    torque = binned(bins, found)
    if tracks is not None:
        surface = bins.mean @ texture_map(LAB, bins.spline @ found.tip_m[0])
        torque = torque + texture(LAB, tracks, surface, forward=not action.backward)
    return -torque[:, ::-1] if action.backward else torque


def mountings(count: int, rng: np.random.Generator) -> Float64Array:
    """The rig's offsets, and what mountings of a lab differ by."""
    rows = np.tile(latents(1, **OFF), (count, 1))
    for name, sd in {"friction": 0.05, "along_m": 0.5e-3, "height_m": 0.1e-3}.items():
        rows[:, LATENTS.index(name)] += sd * rng.standard_normal(count)
    return rows


def taught(mounted: list[Float64Array], tracks: Sequence[Float64Array | None]) -> TrainedTraces:
    rng = np.random.default_rng(4)
    felt, of = [], []
    for depth, depth_m in enumerate(DEPTHS_M):
        for action in FORWARD:
            torque = np.repeat(swept(depth_m, action, mounted[depth], tracks[depth]), 4, axis=0)
            felt.append(torque + rng.normal(0.0, 5e-6, torque.shape))
            of += [(depth_m, action.ring_m, 3 * depth + k // 4) for k in range(12)]
    depths, rings, numbers = zip(*of, strict=True)
    return learn(np.concatenate(felt), depths, rings, numbers, floor_n_m=SETTINGS.floor_n_m)


@pytest.fixture(scope="module")
def mounted() -> list[Float64Array]:
    """Training's mountings of each depth."""
    rng = np.random.default_rng(1)
    return [mountings(3, rng) for _ in DEPTHS_M]


@pytest.fixture(scope="module")
def rough(mounted: list[Float64Array]) -> TrainedTraces:
    """Training on surfaces with a texture."""
    rng = np.random.default_rng(5)
    return taught(mounted, [track(rng, 3) for _ in DEPTHS_M])


@pytest.fixture(scope="module")
def trained(mounted: list[Float64Array]) -> TrainedTraces:
    return taught(mounted, [None] * 3)


@pytest.fixture(scope="module")
def known(trained: TrainedTraces) -> ActionModel:
    return action_model(SETTINGS, trained, [*FORWARD, DEEPER, BACK, LATER])


def read(known: ActionModel, setting: int) -> np.ndarray:
    """The bins that a setting reads."""
    return np.diagonal(known.model.scatter[setting]) < 0.1


def test_training_s_own_sweeps_are_those_of_the_model_without_actions(
    trained: TrainedTraces, known: ActionModel
) -> None:
    plain = SETTINGS.model(trained)
    np.testing.assert_array_equal(known.model.mean[:, :2], plain.mean)
    np.testing.assert_array_equal(known.model.scatter[:2], plain.scatter)
    offsets = plain.slope.shape[-1]
    belief = begin_sweep(start(known.model), 1, landed=True)
    other = begin_sweep(start(plain), 1, landed=True)
    felt = plain.mean[1, 1] + 1e-4
    np.testing.assert_allclose(
        observe(known.model, belief, felt).log_density, observe(plain, other, felt).log_density, rtol=1e-12
    )
    assert known.model.slope.shape[-1] > offsets
    assert known.offered == (*FORWARD, DEEPER, BACK, LATER)
    assert not known.refused


@pytest.mark.parametrize("action", [DEEPER, BACK], ids=["deeper", "back"])
def test_a_sweep_that_was_not_trained_is_foretold_by_mechanics_and_training(
    mounted: list[Float64Array], known: ActionModel, action: SweepAction
) -> None:
    """Against sweeps of training's own mountings, solved at that indentation, in that direction."""
    setting = known.setting[known.offered.index(action)]
    bins = read(known, setting)
    assert bins.sum() >= 18
    for of, depth_m in enumerate(DEPTHS_M):
        true = swept(depth_m, action, mounted[of]).mean(axis=0)
        missed = np.abs(known.model.mean[of, setting] - true)[bins]
        alone = np.abs(swept(depth_m, action, latents())[0] - true)[bins]  # the mechanics alone
        assert missed.mean() < 0.1 * alone.mean()


@pytest.mark.parametrize("action", [DEEPER, BACK, LATER], ids=["deeper", "back", "later"])
def test_what_is_foretold_is_no_surer_than_it_is_right(rough: TrainedTraces, action: SweepAction) -> None:
    """On other mountings with a surface: innovations of the true depth are standard normal, or smaller."""
    rng, known = np.random.default_rng(2), action_model(SETTINGS, rough, [action])
    setting = known.setting[known.offered.index(action)]
    bins = read(known, setting)
    for of, depth_m in enumerate(DEPTHS_M):
        torque = swept(depth_m, action, mountings(12, rng), track(rng, 12))
        torque += rng.normal(0.0, 5e-6, torque.shape)
        belief = observe(known.model, begin_sweep(start(known.model, 12), setting, landed=True), torque)
        squares = belief.innovation[:, of, bins] ** 2
        assert squares.mean() < 1.3


def test_a_sweep_that_begins_later_sticks_anew_and_is_training_s_afterwards(known: ActionModel) -> None:
    whole, later = known.setting[1], known.setting[known.offered.index(LATER)]
    assert not read(known, later)[:8].any()
    np.testing.assert_array_equal(known.model.mean[:, later, :25], known.model.mean[:, whole, 5:])
    assert known.bins[known.offered.index(LATER)] == 25


def test_a_shallower_sweep_that_slides_sooner_is_read_where_training_was(trained: TrainedTraces) -> None:
    """Where training's tip stuck it taught no stick-slip: a filter that reads on there is sure and wrong."""
    shallower = replace(FORWARD[1], indentation_m=0.003)
    known = action_model(SETTINGS, trained, [FORWARD[1], shallower])
    slides = ~sticking(known.model.place_m)
    assert slides[1].sum() > slides[0].sum()
    np.testing.assert_array_equal(read(known, 1), slides[0])


def test_the_rig_is_known_less_where_training_was_not(known: ActionModel) -> None:
    deeper = known.setting[known.offered.index(DEEPER)]
    count = len(LATENTS) + 1  # and the sensor's zero
    left_open = known.model.slope[..., count : 2 * count]
    assert np.abs(left_open[:, deeper]).max() > 1e-6
    assert not left_open[:, :2].any()


def test_what_would_pass_a_limit_is_not_offered(trained: TrainedTraces, known: ActionModel) -> None:
    whole, deeper = FORWARD[1], DEEPER
    expected = [expected_torque_n_m(known.model, n, 30, 3.0) for n in (1, known.setting[2])]
    assert np.abs(known.model.mean[:, 1]).max() < expected[0] < expected[1]
    between = LoadLimits(torque_n_m=0.5 * sum(expected), force_n=10.0)
    few = action_model(SETTINGS, trained, [whole, deeper], between)
    assert few.offered == (whole,)
    assert few.refused[deeper].startswith("a torque of")
    some = action_model(SETTINGS, trained, [whole, deeper], replace(STOP, force_n=1.1))
    assert some.offered == (whole,)
    assert some.refused[deeper].startswith("a force of")
    with pytest.raises(PerceptionError, match="no action is left to choose: a torque of"):
        action_model(SETTINGS, trained, [whole, deeper], LoadLimits(torque_n_m=1e-3, force_n=10.0))


def test_the_limits_are_those_at_which_the_safety_node_stops() -> None:
    params = SafetyParams(device="aerotech", stop_link="none")
    assert (STOP.torque_n_m, STOP.force_n) == (params.stop_n_mm * 1e-3, params.stop_n)


def test_actions_that_are_not_of_this_rig_say_why(trained: TrainedTraces) -> None:
    wrong = {
        replace(BACK, ring_m=0.010): "the ring was not trained at 10 mm",
        replace(BACK, to_m=-0.030): "it leaves the path of training, -26 to 34 mm",
        replace(BACK, to_m=-0.025): "it begins or ends within a bin of 2 mm",
        replace(BACK, indentation_m=0.0075): "",
    }
    found = action_model(SETTINGS, trained, [FORWARD[1], *wrong])
    assert found.offered == (FORWARD[1],)
    assert found.refused.keys() == wrong.keys()
    for action, words in wrong.items():
        assert found.refused[action].startswith(words)
        assert found.refused[action]


def test_every_combination_is_an_action_once() -> None:
    asked = ActionSet(RINGS_M, (0.004, 0.0045), (0.02,), (HOME, HOME[::-1]))
    assert len(set(asked.actions)) == 8
    assert asked.actions[0] == FORWARD[0]
    with pytest.raises(PerceptionError, match="a way and a speed"):
        SweepAction(0.016, 0.004, 0.02, 0.01, 0.01)
