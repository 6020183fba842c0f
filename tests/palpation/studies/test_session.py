"""Sessions in a world: features as the chain reads them, equal luck, and what differs in the trials."""

import contextlib
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from nodes.experiment_plan import ExperimentParams, design_of
from palp_core.methods import find
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.session import plan
from palp_core.palpation.session.orders import MOUNTINGS
from palp_core.palpation.studies.plan import Conditions, Gel, sweep_torque
from palp_core.palpation.studies.session import PLANS, WorldPlan, begin, feature_of
from palp_core.palpation.studies.training import train_feature
from palp_core.palpation.world.draws import PARTS
from palp_core.palpation.world.latents import LATENTS
from palp_core.palpation.world.model import LAB, PAPER

SMALL = Gel(rings_m=(0.016,), reading="trace")
FEW = Conditions(training=4, trials=3, specimens="other", phantoms=2, mounting="each_trial")


@pytest.fixture(scope="module", autouse=True)
def table_of_the_lab() -> None:
    """Set up what the sessions of the lab's world share."""
    WorldPlan(world=LAB, gel=SMALL).table(SMALL)


@pytest.mark.parametrize("feature", ["peak", "contrast"])
def test_bins_give_the_feature_that_the_chain_reads(feature: str) -> None:
    rng = np.random.default_rng(1)
    apart = []
    for depth_m in Gel().depths_m:
        for ring_m in (0.008, 0.016):
            torque = sweep_torque(Gel(), depth_m, ring_m)
            noisy = torque + rng.normal(0.0, RESOLUTION_N_M, len(torque))
            chain = find("feature", feature).target(denoise(noisy), edge=edge_cone()).value_n_m
            ours = feature_of(feature, noisy.reshape(1, -1, 50).mean(axis=2))[0]
            apart.append(ours - chain)
    assert np.abs(apart).max() < 1e-4  # half of what a texture of 0.2 N mm adds; training has it too


def test_sessions_of_one_seed_share_their_luck_and_differ_in_their_shift() -> None:
    few = WorldPlan(world=LAB, conditions=FEW, gel=SMALL)
    one, again = begin(few, (1, 2)), begin(few, (1, 2))
    other = begin(replace(few, shift=(("friction", 0.2),)), (1, 2))
    every, ring = np.arange(len(one.depth)), np.zeros(len(one.depth), dtype=np.int64)
    felt = [s.traces(every, ring, s.kept_landing_m, 0) for s in (one, again, other)]
    np.testing.assert_array_equal(felt[0], felt[1])
    np.testing.assert_array_equal(one.training.traces, other.training.traces)
    assert (felt[2][:, 40:] > felt[0][:, 40:]).all()  # more friction, more drag
    aside = begin(replace(few, shift=(("beside_m", 3e-3),)), (1, 2))
    np.testing.assert_allclose(aside.parts - one.parts, 3e-3 * np.eye(7)[[PARTS.index("beside_m")] * 9])
    lower = aside.traces(every, ring, aside.kept_landing_m, 0).max(axis=1)[:3] - felt[0].max(axis=1)[:3]
    assert (lower < 0.0).all()  # past a shallow bead, not over it
    assert not np.array_equal(begin(few, (1, 3)).training.traces, one.training.traces)


def mountings(design: plan.ExperimentDesign, phase: str) -> list[str]:
    """Return the phantom of each mounting of a phase, as the graph's experiment has it."""
    found, step, mounted = [], next(steps := plan.experiment(design, np.random.default_rng(1))), ""
    with contextlib.suppress(StopIteration):
        while True:
            word = "done"
            if isinstance(step, plan.MountPhantom):
                mounted = step.phantom
            elif isinstance(step, plan.BeginTrial) and mounted and step.phase == phase:
                found.append(mounted)
                mounted = ""
            elif isinstance(step, plan.Palpate) and not step.ring_given:
                word = "decided"
            step = steps.send(plan.StepReply(word))  # type: ignore[arg-type]
    return found


@pytest.mark.parametrize("specimens", get_args(plan.Specimens))
@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_mounting_and_specimens_make_the_same_world_on_the_graph_and_in_a_study(
    mounting: str, specimens: plan.Specimens
) -> None:
    """Phantoms and mountings are as many in both, and as many trials are of phantoms of training."""
    phantoms = PLANS["lab"].conditions.phantoms if specimens == "other" else 1
    conditions = Conditions(mounting=mounting, specimens=specimens, phantoms=phantoms, training=6, trials=6)
    session = begin(WorldPlan(LAB, conditions, SMALL), (1, 8))
    design = design_of(
        ExperimentParams(
            mounting=mounting,
            specimens=specimens,
            phantoms="castings" if specimens == "other" else "",
            rings_mm="16",
            training=6 // conditions.phantoms,
            trials=6 // conditions.phantoms,
        )
    )
    assert isinstance(design, plan.ExperimentDesign)
    trained, tested = mountings(design, "training"), mountings(design, "estimation")
    assert len(set(session.training.mounting.tolist())) == len(trained)
    assert len(np.unique(session.tracks[:, 0, 0])) == len(tested)
    assert len(set(session.phantom.tolist())) == len(set(tested))
    assert len(np.unique(session.parts[:, LATENTS.index("modulus")])) == len(set(tested))
    assert ({*trained} == {*tested}, bool({*trained} & {*tested})) == (specimens == "same",) * 2


@pytest.mark.parametrize("specimens", get_args(plan.Specimens))
def test_trials_feel_the_phantoms_of_training_or_others(specimens: plan.Specimens) -> None:
    alike = Conditions(repeatability_m=0.0, height_sd_m=0.0, training=4, trials=4, specimens=specimens)
    session = begin(WorldPlan(replace(PAPER, modulus_specimen_sd=0.1), alike, SMALL), (1, 9))
    every = np.arange(12)
    felt = feature_of("peak", session.traces(every, np.zeros_like(every), np.zeros(12), 0)).reshape(3, 4)
    trained = feature_of("peak", session.training.traces).reshape(3, 4)
    off = np.abs(felt.mean(axis=1) / trained.mean(axis=1) - 1.0)
    assert (off < 1e-3).all() if specimens == "same" else (off > 1e-3).all()


def test_a_grouped_mounting_is_one_phantoms() -> None:
    grouped = replace(FEW, trials=4, mounting="grouped", repeatability_m=0.0)
    met = begin(WorldPlan(conditions=grouped, gel=SMALL), (3, 4)).parts[:, 1].reshape(3, 4)
    assert np.array_equal(met[:, :2], met[:, 2:])
    assert (met[:, 0] != met[:, 1]).all()


def test_what_drifts_after_training_is_in_every_sweep_of_the_trials() -> None:
    still, drifted = (
        begin(WorldPlan(conditions=replace(FEW, drift_n_m=drift), gel=SMALL), (3, 6)) for drift in (0.0, 1e-3)
    )
    every, ring = np.arange(9), np.zeros(9, dtype=np.int64)
    apart = [s.traces(every, ring, np.zeros(9), 0) for s in (drifted, still)]
    np.testing.assert_allclose(apart[0] - apart[1], drifted.bias_n_m, atol=1e-12)
    assert drifted.bias_n_m != 0.0
    np.testing.assert_array_equal(still.training.traces, drifted.training.traces)


def test_the_papers_world_has_no_texture_and_the_lab_has() -> None:
    def roughness(world: object) -> float:
        session = begin(WorldPlan(world=world, conditions=FEW, gel=SMALL), (1, 4))  # type: ignore[arg-type]
        bare = session.training.traces[:, 66:]  # past the bead, sliding
        return float(np.diff(bare, axis=1).std())

    assert roughness(PAPER) < 1e-5 < 3e-5 < roughness(LAB)


def test_other_depths_are_felt_in_trials_than_were_trained() -> None:
    session = begin(WorldPlan(conditions=FEW, gel=SMALL, test_depths_m=(0.003, 0.006)), (1, 5))
    assert session.depths_m == (0.003, 0.006)
    assert session.depth.tolist() == [0, 0, 0, 1, 1, 1]
    assert set(session.training.depth.tolist()) == {0, 1, 2}


def test_training_that_lands_once_a_cell_does_not_scatter_by_landing() -> None:
    few = WorldPlan(conditions=replace(FEW, height_sd_m=0.0), gel=SMALL)
    spread = {}
    for lands in ("each", "cell"):
        session = begin(replace(few, conditions=replace(few.conditions, training_lands=lands)), (1, 7))
        shallow = session.training.depth == 0
        spread[lands] = float(feature_of("peak", session.training.traces)[shallow].std())
    assert spread["cell"] < 0.3 * spread["each"]


def test_nodules_may_be_decided_among_more_depths_than_there_are() -> None:
    session = begin(WorldPlan(conditions=FEW, gel=SMALL, test_depths_m=(0.003, 0.006)), (1, 5))
    grid_m = (0.002, 0.003, 0.004, 0.006, 0.008)
    assert train_feature(session, "contrast", grid_m=grid_m).depth.tolist() == [1, 1, 1, 3, 3, 3]
    assert train_feature(session, "contrast").depth.tolist() == [0, 0, 0, 1, 1, 1]
