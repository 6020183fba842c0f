import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.resampling import (
    cluster_bootstrap,
    compare,
    holm,
    share_interval,
    sign_flip,
)

shares = st.lists(st.floats(0, 1), min_size=1, max_size=12)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@given(shares)
@settings(max_examples=10, deadline=None)
def test_an_interval_holds_its_mean_and_stays_where_the_value_can_lie(values: list[float]) -> None:
    found = cluster_bootstrap(values, rng(), resamples=400, within=(0.0, 1.0))
    assert 0.0 <= found.low <= found.value + 1e-12
    assert found.value - 1e-12 <= found.high <= 1.0
    assert found.value == pytest.approx(np.mean(values))


@pytest.mark.parametrize("count", [2, 8])
def test_the_interval_of_few_sessions_covers_as_often_as_it_says(count: int) -> None:
    hits = 0
    for seed in range(300):
        draws = np.random.default_rng(seed)
        found = cluster_bootstrap(draws.normal(0.8, 0.1, count), draws, resamples=400)
        hits += found.low <= 0.8 <= found.high
    assert 0.915 <= hits / 300 <= 0.985


def test_two_sessions_without_a_mistake_are_not_certainty() -> None:
    found = share_interval([[True] * 9, [True] * 9], rng())
    assert (found.value, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(0.8241, abs=1e-4)  # Wilson, 18 of 18
    mixed = share_interval([[True, False], [True, True], [False, False]], rng())
    assert 0.0 <= mixed.low < mixed.value == 0.5 < mixed.high <= 1.0
    with pytest.raises(PerceptionError, match="a trial in every session"):
        share_interval([[True], []], rng())


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
@settings(max_examples=30, deadline=None)
def test_holm_keeps_the_order_and_lies_between_p_and_bonferroni(values: list[float]) -> None:
    adjusted = holm(values)
    for p, q in zip(values, adjusted, strict=True):
        assert p <= q + 1e-12
        assert q <= min(1.0, len(values) * p) + 1e-12 or q <= max(adjusted)
    order = np.argsort(values, kind="stable")
    assert all(np.diff(np.array(adjusted)[order]) >= -1e-12)


def test_holms_own_example() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])


@pytest.mark.parametrize("count", [6, 20])
def test_the_sign_flip_finds_what_all_sessions_agree_on(count: int) -> None:
    p = sign_flip(np.full(count, 0.1) + 0.01 * rng().random(count), rng())
    assert p == pytest.approx(2 / 2**count, rel=1e-9) if count == 6 else p < 1e-3


def test_methods_are_compared_within_sessions() -> None:
    luck = rng().normal(0.7, 0.1, 24)
    (found,) = compare({"a": luck + 0.02, "b": luck}, [("a", "b")], rng())
    assert (found.difference.low, found.difference.high) == pytest.approx((0.02, 0.02))
    assert found.p_holm < 0.01


def test_what_did_not_meet_the_same_sessions_is_refused() -> None:
    with pytest.raises(PerceptionError, match="same sessions"):
        compare({"a": [1.0], "b": [1.0, 0.0]}, [("a", "b")], rng())
    with pytest.raises(PerceptionError, match="same sessions"):
        compare({"a": [1.0]}, [("a", "c")], rng())
    with pytest.raises(PerceptionError, match="one finite value"):
        cluster_bootstrap([], rng())


@pytest.mark.parametrize("values", [[], [0.1, np.nan], [[0.1, 0.2]]])
def test_differences_without_a_number_for_each_session_are_refused(values: list[float]) -> None:
    with pytest.raises(PerceptionError, match="one finite difference"):
        sign_flip(values, rng())


@pytest.mark.parametrize("p_values", [[0.01, np.nan], [1.2], [-0.1]])
def test_what_is_no_p_value_is_no_member_of_a_family(p_values: list[float]) -> None:
    with pytest.raises(PerceptionError, match="between 0 and 1"):
        holm(p_values)
