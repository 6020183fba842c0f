"""Sessions in a world: features as the chain reads them, equal luck, and what differs in the trials."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.methods import find
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.studies.frontier.protocols import PAPER_PROTOCOL, SWIFT
from palp_core.palpation.studies.frontier.trace_features import feature_of
from palp_core.palpation.studies.frontier.world_session import WorldPlan, begin
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.reading_table import Gel, sweep_torque
from palp_core.palpation.world.draws import PARTS
from palp_core.palpation.world.model import LAB, PAPER

SMALL = Gel(rings_m=(0.016,))
FEW = Conditions(training=4, trials=3, specimens=2, remount=True)


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


def test_sessions_of_one_seed_share_their_luck_and_differ_in_what_is_told() -> None:
    plan = WorldPlan(world=LAB, conditions=FEW, gel=SMALL)
    one, again = begin(plan, (1, 2)), begin(plan, (1, 2))
    other = begin(replace(plan, shift=(("friction", 0.2),)), (1, 2))
    every, ring = np.arange(len(one.depth)), np.zeros(len(one.depth), dtype=np.int64)
    felt = [s.traces(every, ring, s.kept_landing_m, 0) for s in (one, again, other)]
    np.testing.assert_array_equal(felt[0], felt[1])
    np.testing.assert_array_equal(one.training.traces, other.training.traces)
    assert (felt[2][:, 40:] > felt[0][:, 40:]).all()  # more friction, more drag
    aside = begin(replace(plan, shift=(("beside_m", 3e-3),)), (1, 2))
    np.testing.assert_allclose(aside.parts - one.parts, 3e-3 * np.eye(7)[[PARTS.index("beside_m")] * 9])
    lower = aside.traces(every, ring, aside.kept_landing_m, 0).max(axis=1)[:3] - felt[0].max(axis=1)[:3]
    assert (lower < 0.0).all()  # past a shallow bead, not over it
    assert not np.array_equal(begin(plan, (1, 3)).training.traces, one.training.traces)


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
    plan = WorldPlan(conditions=replace(FEW, height_sd_m=0.0), gel=SMALL)
    spread = {}
    for lands in ("each", "cell"):
        session = begin(replace(plan, conditions=replace(plan.conditions, training_lands=lands)), (1, 7))
        shallow = session.training.depth == 0
        spread[lands] = float(session.feature("peak").training()[shallow].std())
    assert spread["cell"] < 0.3 * spread["each"]


def test_conditions_that_whole_sweeps_do_not_know_are_refused() -> None:
    with pytest.raises(PalpError, match="whole sweeps know no landing 'level'; leave it out"):
        WorldPlan(conditions=replace(FEW, landing="level"))


def test_nodules_may_be_decided_among_more_depths_than_there_are() -> None:
    session = begin(WorldPlan(conditions=FEW, gel=SMALL, test_depths_m=(0.003, 0.006)), (1, 5))
    trials = session.feature("contrast", (0.002, 0.003, 0.004, 0.006, 0.008))
    assert trials.depths_m == (0.002, 0.003, 0.004, 0.006, 0.008)
    assert trials.depth.tolist() == [1, 1, 1, 3, 3, 3]
    assert session.feature("contrast").depth.tolist() == [0, 0, 0, 1, 1, 1]


def test_an_unknown_feature_is_named() -> None:
    session = begin(WorldPlan(conditions=FEW, gel=SMALL), (1, 6))
    with pytest.raises(PalpError, match="no feature 'sum'; there are peak, contrast"):
        session.feature("sum")


def test_a_whole_sweep_of_the_paper_takes_what_the_stage_takes() -> None:
    whole = np.array([0.08])
    assert PAPER_PROTOCOL.sweep_s(whole)[0] == pytest.approx(4.14, abs=0.005)
    assert PAPER_PROTOCOL.back_s(whole)[0] == pytest.approx(3.74, abs=0.01)
    assert SWIFT.sweep_s(np.array([0.04]))[0] < 2.2
