"""Choosing a sweep: what it is expected to tell, a second, of what is offered."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.actions import ActionModel, LoadLimits, SweepAction
from palp_core.palpation.perception.trace.belief import begin_sweep, observe, start
from palp_core.palpation.perception.trace.information import expected_bits
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.texture import Texture

BINS = 8
FORWARD, SHORT, BACK = (
    SweepAction(0.016, 0.004, 0.02, *path) for path in ((0.0, 0.016), (0.0, 0.008), (0.016, 0.0))
)
SOFT = replace(FORWARD, ring_m=0.008)


def model_of(bins: int = BINS, *, reversing: float = 0.5) -> TraceModel:
    """Three classes at three settings, stiff, stiff and back, soft: the bump is the lower the softer."""
    place = np.arange(bins) * 2e-3
    bump = np.exp(-(((place - 0.008) / 0.004) ** 2))
    mean = np.array([[[h * scale * b for b in bump] for scale in (1.0, 1.0, 0.3)] for h in (4e-4, 2e-4, 0.0)])
    return TraceModel(
        np.arange(3),
        np.zeros(3),
        mean,
        np.ones((*mean.shape, 1)),
        np.array([1e-4]),
        ("trial",),
        np.tile(1e-10 * np.eye(bins), (3, 1, 1)),
        Texture(1e-4, 3e-3, reversing),
        np.tile(place, (3, 3, 1)),
        np.array([False, True, False]),
    )


def offered(model: TraceModel) -> ActionModel:
    return ActionModel(model, (FORWARD, SHORT, BACK, SOFT), (0, 0, 1, 2), (BINS, 4, BINS, BINS), {})


def test_a_path_that_ends_early_tells_what_a_model_of_its_bins_would() -> None:
    whole, cut = model_of(), model_of(4)
    first = observe(whole, begin_sweep(start(whole, 3), 2, landed=True), np.full((3, 4), 1e-4))
    same = observe(cut, begin_sweep(start(cut, 3), 2, landed=True), np.full((3, 4), 1e-4))
    found = expected_bits(whole, first, 0, landed=True, bins=4)
    np.testing.assert_allclose(found, expected_bits(cut, same, 0, landed=True), rtol=1e-9)
    more = [expected_bits(whole, start(whole), 0, landed=True, bins=n)[0] for n in range(1, BINS + 1)]
    assert (np.diff(more) > 0.0).all()
    assert more[-1] == expected_bits(whole, start(whole), 0, landed=True)[0]


def test_the_most_bits_a_second_are_chosen_and_not_the_most_bits() -> None:
    known = offered(model_of())
    before = start(known.model, 2)
    bits = known.expected_bits(before, None)
    assert bits.shape == (2, 4)
    assert bits[0, 0] > bits[0, 1] > 0.0
    assert bits[0, 0] > bits[0, 3]
    chosen, told = known.best(before, None, np.full(4, 3.0))
    assert chosen.tolist() == [0, 0]  # as good as back, and the first of the two
    np.testing.assert_array_equal(told, bits[:, 0])
    dear = np.array([3.0 * bits[0, 0] / bits[0, 1], 2.9, 9.0, 9.0])
    assert known.best(before, None, dear)[0].tolist() == [1, 1]


@pytest.mark.parametrize("reversing", [0.5, 1.0, 0.0])
def test_a_look_back_meets_another_surface_and_one_forward_the_same(reversing: float) -> None:
    """Half of a texture turns with the direction: there back is a look of its own, and once more is none."""
    known = offered(model_of(reversing=reversing))
    mean = known.model.mean[1, 0] + 2e-5
    belief = observe(known.model, begin_sweep(start(known.model), 0, landed=True), mean)
    again, _, back, _ = known.expected_bits(belief, FORWARD.ring_m)[0]
    if reversing == 0.5:
        assert back > again + 0.02
    elif reversing == 1.0:
        assert back == pytest.approx(again, rel=1e-6)  # all of it is friction: the same, against the sweep
    else:
        assert back > again  # all of it is shape: the difference of the two has none


def test_an_action_on_offer_can_be_taken_off() -> None:
    known = offered(model_of())
    some = known.only({BACK, SOFT})
    assert some.offered == (BACK, SOFT)
    assert (some.setting, some.bins) == ((1, 2), (BINS, BINS))
    np.testing.assert_array_equal(
        some.expected_bits(start(some.model), None)[0], known.expected_bits(start(known.model), None)[0, 2:]
    )
    with pytest.raises(PerceptionError, match="no action is left to choose: none was named"):
        known.only({replace(BACK, ring_m=0.004)})


def test_a_limit_says_by_how_much_it_would_be_passed() -> None:
    limits = LoadLimits(torque_n_m=0.1, force_n=10.0)
    assert limits.refusal(0.09, 9.0) == ""
    assert limits.refusal(0.11, 9.0) == "a torque of 110 N mm may come; the limit is 100"
    assert limits.refusal(0.09, 12.0) == "a force of 12 N may come; the limit is 10"
    assert limits.refusal(float("nan"), 0.0)
