"""Shares, calibration, intervals over sessions, and tests of effects."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.anova import (
    Anova,
    NotTestable,
    bonferroni,
    permutation,
    two_way,
)
from palp_core.palpation.perception.statistics.resampling import (
    cluster_bootstrap,
    compare,
    holm,
    share_interval,
    sign_flip,
)
from palp_core.palpation.perception.statistics.statistics import (
    calibration,
    confusion,
    wilson,
)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilsons_interval_has_its_published_values(
    successes: int, trials: int, low: float, high: float
) -> None:
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    found = wilson(successes, trials)
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


def test_the_interval_is_scipys_to_the_last_bit() -> None:
    for trials in (1, 2, 3, 7, 20, 263, 12_000):
        for successes in {0, 1, trials // 3, trials // 2, trials - 1, trials}:
            found = wilson(successes, trials)
            theirs = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
            assert (found.low, found.high) == (theirs.low, theirs.high)


def test_confusions_are_counted_by_actual_class() -> None:
    actual, estimated = [0, 0, 0, 1, 1, 2], [0, 0, 1, 1, 2, 2]
    assert confusion(actual, estimated, 3).tolist() == [[2, 1, 0], [0, 1, 1], [0, 0, 1]]


def test_deserved_confidence_is_calibrated_and_boasting_is_not() -> None:
    rng = np.random.default_rng(0)
    stated = rng.uniform(1 / 3, 1.0, 20_000)
    honest = calibration(stated, list(rng.random(20_000) < stated))
    assert honest.expected_error < 0.02
    boasting = calibration(np.full(1000, 0.95), list(rng.random(1000) < 0.6))
    assert boasting.overconfidence == pytest.approx(0.35, abs=0.05)
    assert boasting.expected_error == pytest.approx(0.35, abs=0.05)
    assert len(boasting.bins) == 1


def test_certainty_falls_into_the_last_bin_and_every_trial_into_one() -> None:
    found = calibration(np.array([0.0, 0.5, 1.0]), [False, True, True], bin_count=2)
    assert [(b.low, b.high, b.accuracy.trial_count) for b in found.bins] == [(0.0, 0.5, 2), (0.5, 1.0, 1)]


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


NAMES = ("depth", "ring")


def table(each: int = 30) -> tuple[list[int], list[str]]:
    depth = np.repeat([2, 4, 8], 2 * each).tolist()
    return depth, ["a", "b"] * (3 * each)


def outcomes(seed: int, effect: float) -> np.ndarray:
    rng, (depth, _) = np.random.default_rng(seed), table()
    return np.where(rng.random(180) < 0.5 + effect * (np.array(depth) == 2), 1.0, 0.0)


def test_an_effect_is_found_and_its_absence_too() -> None:
    found, none = (two_way(outcomes(1, effect), *table(), names=NAMES) for effect in (0.45, 0.0))
    assert isinstance(found, Anova)
    assert isinstance(none, Anova)
    assert found.p("depth") < 1e-4 < 0.05 < none.p("depth:ring")
    assert "independent" in found.caution


def test_a_balanced_table_is_worked_out_by_hand() -> None:
    """Two by two with two values a cell: sums of squares 8, 2 and 0, residual 4 over 4."""
    values = [0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0]
    found = two_way(np.array(values) * 1.0, [0, 0, 0, 0, 1, 1, 1, 1], [0, 0, 1, 1, 0, 0, 1, 1], names=NAMES)
    assert isinstance(found, Anova)
    assert [e.statistic for e in found.effects] == pytest.approx([16.0, 4.0, 0.0], abs=1e-9)
    assert found.residual_df == 4


def test_cells_that_are_all_or_none_are_not_testable() -> None:
    depth, ring = table()
    right = [float((d, r) in {(2, "a"), (2, "b"), (4, "a")}) for d, r in zip(depth, ring, strict=True)]
    found = two_way(right, depth, ring, names=NAMES)
    assert isinstance(found, NotTestable)
    assert "all right or all wrong" in found.reason


@pytest.mark.parametrize(
    ("values", "first", "second", "reason"),
    [
        ([0.0, 1.0, 1.0, 0.0], [0, 0, 1, 1], [0, 1, 0, 1], "one value"),
        ([0.0, 1.0, 1.0, 0.0], [0, 0, 1, 1], [0, 0, 1, 1], "empty"),
        ([0.0, 1.0, 1.0, 0.0], [0, 0, 1, 1], [0, 0, 0, 0], "only one level"),
        ([0.0, np.nan, 1.0, 0.0], [0, 0, 1, 1], [0, 1, 0, 1], "not finite"),
    ],
)
def test_a_table_that_has_no_answer_says_why(
    values: list[float], first: list[int], second: list[int], reason: str
) -> None:
    found = two_way(values, first, second, names=NAMES)
    assert isinstance(found, NotTestable)
    assert reason in found.reason


def test_bonferroni_multiplies_by_the_pairs_and_leaves_out_what_cannot_be_tested() -> None:
    values = [*outcomes(3, 0.45).tolist(), *[1.0] * 10, *[1.0] * 10]
    groups = [*table()[0], *["x"] * 10, *["y"] * 10]
    found = {(t.first, t.second): t for t in bonferroni(values, groups)}
    assert len(found) == 10
    assert found["x", "y"].p_bonferroni is None
    assert (found["2", "4"].p_bonferroni or 1.0) < 0.01 < (found["4", "8"].p_bonferroni or 0.0)


def test_exchanging_labels_within_sessions_finds_the_effect_and_not_the_sessions() -> None:
    rng, depth = np.random.default_rng(0), table()[0]
    sessions = np.tile([0, 1, 2, 3, 4, 5], 30).tolist()
    assert isinstance(found := permutation(outcomes(1, 0.45), depth, sessions, rng), float)
    assert found < 0.01
    by_session = (np.array(sessions) < 3).astype(float)
    assert permutation(by_session, depth, sessions, rng) == pytest.approx(1.0)
    assert isinstance(permutation(np.ones(180), depth, sessions, rng), NotTestable)
    assert isinstance(permutation(by_session, sessions, sessions, rng), NotTestable)


def test_a_lost_outcome_is_not_testable_whichever_the_test() -> None:
    depth, ring = table()
    values = outcomes(1, 0.45)
    values[3] = np.nan
    rng = np.random.default_rng(0)
    for found in (
        two_way(values, depth, ring, names=NAMES),
        permutation(values, depth, [0] * 180, rng, shuffles=50),
    ):
        assert isinstance(found, NotTestable)
        assert "not finite" in found.reason
    pairs = {(one.first, one.second): one.p_bonferroni for one in bonferroni(values, depth)}
    assert pairs["2", "4"] is None
    assert pairs["4", "8"] is not None


REFUSED: list[tuple[Callable[..., object], tuple[Any, ...], str]] = [
    *((wilson, share, "not a proportion") for share in ((0, 0), (2, 1), (-1, 3))),
    (confusion, ([0], [0, 1], 2), "estimates"),
    (confusion, ([0], [2], 2), "outside"),
    *(
        (calibration, (np.array(stated), right), "one probability")
        for stated, right in (([], []), ([1.2], [True]), ([0.5], [True, False]), ([np.nan], [True]))
    ),
    (share_interval, ([[True], []], rng()), "a trial in every session"),
    (compare, ({"a": [1.0], "b": [1.0, 0.0]}, [("a", "b")], rng()), "same sessions"),
    (compare, ({"a": [1.0]}, [("a", "c")], rng()), "same sessions"),
    (cluster_bootstrap, ([], rng()), "one finite value"),
    *((sign_flip, (of, rng()), "one finite difference") for of in ([], [0.1, np.nan], [[0.1, 0.2]])),
    *((holm, (p_values,), "between 0 and 1") for p_values in ([0.01, np.nan], [1.2], [-0.1])),
    *(
        (test, (values, *labels), "for every trial")
        for values in ([], [1.0, 0.0, 1.0], np.ones((2, 2)))
        for test, *labels in (
            (bonferroni, ["a", "b"]),
            (permutation, ["a", "b"], [0, 0], rng()),
            (functools.partial(two_way, names=NAMES), ["a", "b"], ["c", "d"]),
        )
    ),
]


@pytest.mark.parametrize(("test", "handed", "words"), REFUSED)
def test_what_cannot_be_counted_or_tested_is_refused(
    test: Callable[..., object], handed: tuple[Any, ...], words: str
) -> None:
    with pytest.raises(PerceptionError, match=words):
        test(*handed)
