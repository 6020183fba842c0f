"""A search finds a bead with honest intervals, says none where there is none, and goes on from its lanes."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.search.lanes import POLICIES, free
from palp_core.palpation.perception.search.searcher import Searcher
from palp_core.palpation.perception.search.settings import Lane, LaneRead, SearchSettings
from palp_core.units import Float64Array
from tests.palpation.perception.search.made_up import SETTINGS, answers, run, torque

ANSWERS = [answers()]
NO_BEAD, BEAD = np.zeros((0, 3)), np.array([[0.003, -0.002, 0.0035]])


def searched(beads: Float64Array, settings: SearchSettings = SETTINGS, seed: int = 1) -> Searcher:
    searcher = Searcher(settings, ANSWERS)
    run(searcher, beads, seed)
    return searcher


@pytest.mark.parametrize("policy", POLICIES)
def test_every_policy_finds_a_bead(policy: str) -> None:
    found = searched(BEAD, replace(SETTINGS, policy=policy, most_s=300.0)).outcome()
    assert found.verdict == "bead"
    (bead,) = found.beads
    assert np.linalg.norm(bead.mean[:2] - BEAD[0, :2]) < 1e-3
    assert abs(bead.mean[2] - BEAD[0, 2]) < 1e-3
    assert bead.x_m.low < bead.x_m.value < bead.x_m.high


@pytest.mark.parametrize("policy", POLICIES)
def test_every_policy_says_none(policy: str) -> None:
    found = searched(NO_BEAD, replace(SETTINGS, policy=policy, most_s=300.0)).outcome()
    assert (found.verdict, found.beads) == ("none", ())
    assert found.none > 0.99


def test_a_replacement_goes_on_as_the_search_would_have() -> None:
    searcher = Searcher(SETTINGS, ANSWERS)
    offsets, rng = np.zeros(6), np.random.default_rng(3)
    for _ in range(2):
        lane = searcher.next_lane()
        assert lane is not None
        searcher.read(lane, torque(searcher.level_of(0.016, None), lane, BEAD, offsets, rng))
    packed = msgspec.msgpack.decode(msgspec.msgpack.encode(searcher.to_state()), type=list[LaneRead])
    other = Searcher(SETTINGS, ANSWERS, packed)
    assert other.next_lane() == searcher.next_lane()
    np.testing.assert_array_equal(other.outcome().probability, searcher.outcome().probability)
    assert other.seconds == searcher.seconds


def test_time_that_is_over_ends_it_undecided() -> None:
    found = searched(BEAD, replace(SETTINGS, most_s=8.0, place_sd_m=1e-5))
    assert found.outcome().verdict in ("undecided", "bead")
    assert found.seconds <= 8.0
    assert found.next_lane() is None


def test_a_surface_that_was_not_trained_does_not_fit() -> None:
    rough = Searcher(replace(SETTINGS, texture_sd_n_m=0.8e-3), ANSWERS)
    level, rng = rough.level_of(0.016, None), np.random.default_rng(4)
    searcher = Searcher(replace(SETTINGS, most_s=20.0), ANSWERS)
    while (lane := searcher.next_lane()) is not None:
        searcher.read(lane, torque(level, lane, NO_BEAD, np.zeros(6), rng))
    assert searcher.outcome().verdict == "does_not_fit"
    assert searcher.outcome().fit < SETTINGS.misfit


def test_two_beads_are_named_where_two_are_allowed() -> None:
    settings = replace(SETTINGS, half_m=0.020, bins=28, first_m=-0.024, second=0.2, most_s=200.0)
    searcher = Searcher(settings, [answers(settings)])
    beads = np.array([[-0.010, 0.008, 0.003], [0.012, -0.006, 0.0025]])
    run(searcher, beads, 2)
    found = searcher.outcome()
    assert found.verdict == "two_beads"
    named = np.array(sorted(one.mean.tolist() for one in found.beads))
    np.testing.assert_allclose(named[:, :2], beads[:, :2], atol=1e-3)


def test_greedy_keeps_lanes_of_one_direction_apart() -> None:
    lanes = searched(NO_BEAD).belief.lanes
    assert len(lanes) > 2
    for k, one in enumerate(lanes):
        for other in lanes[:k]:
            alike = one.lane.forward == other.lane.forward
            assert not alike or abs(one.lane.x_m - other.lane.x_m) >= 2.0 * SETTINGS.texture_length_m - 1e-9
    assert not free(searched(NO_BEAD).belief, lanes[0].lane)


def test_what_it_needs_is_asked_for() -> None:
    with pytest.raises(PerceptionError, match="no policy 'drunk'; use greedy, fixed, raster"):
        Searcher(replace(SETTINGS, policy="drunk"), ANSWERS)
    with pytest.raises(PerceptionError, match="no answers for rings"):
        Searcher(replace(SETTINGS, rings_m=(0.008,)), ANSWERS)
    with pytest.raises(PerceptionError, match="cells that divide its half"):
        SearchSettings(cell_m=0.003)


def test_a_lane_takes_longer_where_the_stage_must_go_back() -> None:
    there = Lane(0.0)
    to_and_fro, back = (SETTINGS.lane_s(Lane(0.004, forward), there) for forward in (False, True))
    assert back > to_and_fro > SETTINGS.lift_s


@pytest.mark.nightly
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Of 300 searches a share within three standard errors of 0.95."""
    rng, held = np.random.default_rng(11), []
    for seed in range(300):
        theta = np.array([*rng.uniform(-0.012, 0.012, 2), rng.uniform(0.002, 0.006)])
        found = searched(theta[None], seed=1000 + seed).outcome()
        if found.beads:
            (bead,) = found.beads
            intervals = (bead.x_m, bead.y_m, bead.depth_m)
            held.append([one.low <= true <= one.high for one, true in zip(intervals, theta, strict=True)])
    assert len(held) > 250
    shares = np.mean(held, axis=0)
    assert ((shares > 0.912) & (shares < 0.988)).all(), shares
