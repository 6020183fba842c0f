import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.trial_filter import TrialReading, belief_after
from palp_core.palpation.perception.strategy.policies import RingChoice
from palp_core.palpation.perception.strategy.policies_informed import (
    EmgDriven,
    InformationGainLatent,
    Reposition,
    Timing,
)

RANDOM = np.random.default_rng(0).random
NOTHING_FELT = latent.of_classes(np.full(3, 1 / 3))


def readings_of(ring_sd: float, noise_sd: float = 0.05) -> OffsetModel:
    """Two settings: the second separates the classes, the first does not."""
    mean = np.array([[[0.0], [0.0]], [[0.0], [1.0]], [[0.0], [2.0]]])
    noise = np.full((3, 2, 1, 1), noise_sd**2)
    return OffsetModel(mean, noise, np.ones((3, 2, 1, 1)), np.array([ring_sd]), (True,))


def policy(ring_sd: float, **options: object) -> InformationGainLatent:
    return InformationGainLatent(readings_of(ring_sd), (0.0, 0.016), **options)  # type: ignore[arg-type]


def after_one_probe(one: InformationGainLatent, reading: float = 0.5) -> latent.Belief:
    return latent.update(one.model, latent.start(one.model), reading, 1, True)


def where(choice: RingChoice) -> tuple[int, bool]:
    return int(choice.level), bool(choice.renew)


def test_it_begins_where_the_classes_differ() -> None:
    assert policy(0.3).start(RANDOM).level == 1


def test_it_finds_out_that_a_new_landing_is_worth_a_probe() -> None:
    one = policy(0.5)
    assert where(one.step(RingChoice.at(1), after_one_probe(one), RANDOM)) == (1, True)


@pytest.mark.parametrize("per_second", [False, True])
def test_it_does_not_move_where_nothing_stays(per_second: bool) -> None:
    one = policy(0.0, per_second=per_second)
    assert where(one.step(RingChoice.at(1), after_one_probe(one), RANDOM)) == (1, False)


@given(st.floats(0.2, 1.0), st.floats(0.05, 0.2))
@settings(max_examples=15, deadline=None)
def test_staying_never_promises_more_than_a_new_landing(ring_sd: float, noise_sd: float) -> None:
    one = InformationGainLatent(readings_of(ring_sd, noise_sd), (0.0, 0.016), node_count=129)
    found = one.actions(after_one_probe(one), np.array(1))
    assert found.gain_bits[2] <= found.gain_bits[1] + 1e-4


def test_seconds_are_those_of_the_moves() -> None:
    one = policy(0.3, timing=Timing(sweep_s=8.0, ring_m_per_s=0.005, settle_s=0.2, home_m=0.001))
    found = one.actions(after_one_probe(one), np.array(1))
    assert found.seconds == pytest.approx([8.0 + 16 / 5 + 0.2, 8.0 + 2 * 17 / 5 + 0.2, 8.0])


def test_a_history_of_readings_is_as_good_as_the_belief() -> None:
    one = policy(0.5)
    found = after_one_probe(one)
    read = belief_after(one.model, [TrialReading(0.5, 1, True)]).with_classes(found.posterior)
    choice = one.step(RingChoice.at(1), read, RANDOM)
    assert where(choice) == where(one.step(RingChoice.at(1), found, RANDOM))
    assert choice.renew


def test_reposition_lands_again_before_every_probe_but_the_first() -> None:
    one = Reposition(0.012)
    first = one.start(RANDOM)
    assert not first.renew
    assert one.step(first, NOTHING_FELT, RANDOM).renew
    assert one.rings_m == (0.012,)


def test_the_persons_level_is_followed_and_kept_in_a_pause() -> None:
    assert EmgDriven().start(RANDOM).level == 2
    assert EmgDriven(latest=4).step(RingChoice.at(1), NOTHING_FELT, RANDOM).level == 4
    assert EmgDriven().step(RingChoice.at(1), NOTHING_FELT, RANDOM).level == 1


def test_a_level_without_a_ring_position_is_refused() -> None:
    with pytest.raises(PerceptionError, match="level 5 has no ring position"):
        EmgDriven(latest=5)
