import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.anova import (
    Anova,
    NotTestable,
    bonferroni,
    permutation,
    two_way,
)

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


@pytest.mark.parametrize("values", [[], [1.0, 0.0, 1.0], np.ones((2, 2))])
def test_a_test_without_a_label_for_every_trial_is_refused(values: list[float]) -> None:
    with pytest.raises(PerceptionError, match="for every trial"):
        two_way(values, ["a", "b"], ["c", "d"], names=NAMES)
    with pytest.raises(PerceptionError, match="for every trial"):
        bonferroni(values, ["a", "b"])
    with pytest.raises(PerceptionError, match="for every trial"):
        permutation(values, ["a", "b"], [0, 0], np.random.default_rng(0))
