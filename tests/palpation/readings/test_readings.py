"""Readings by names: whatever has a text is a name, and what is no number is left out and said."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.readings.readings import ONLY_SETTING, Readings


def test_names_are_in_the_order_of_numbers_or_of_letters() -> None:
    found = Readings.of([1.0, 2.0, 3.0], [10, 9, 2], settings=["b", "a", "b"])
    assert found.classes == ("2", "9", "10")
    assert found.class_index.tolist() == [2, 1, 0]
    assert (found.settings, found.setting_index.tolist()) == (("a", "b"), [1, 0, 1])
    assert (found.columns, found.values.shape) == (("0",), (3, 1))


def test_without_settings_there_is_one_and_without_trials_each_row_is_one() -> None:
    found = Readings.of(np.arange(6.0).reshape(3, 2), np.array(["x", "y", "x"]))
    assert found.settings == (ONLY_SETTING,)
    assert len(found.trials) == 3
    assert found.counts().tolist() == [[2], [1]]


def test_readings_that_are_no_finite_numbers_are_left_out_and_said() -> None:
    values = np.array([[1.0, 2.0], [np.nan, 1.0], [1.0, np.inf], [3.0, 4.0]])
    found = Readings.of(values, ["a", "b", "a", "b"], columns=["force", "pitch"])
    assert found.values.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert found.notes == ("2 of 4 readings are left out: no finite number in force, pitch (rows 1, 2)",)


def test_a_note_names_eight_rows_at_most() -> None:
    values = np.concatenate([np.full(20, np.nan), [1.0, 2.0]])
    (note,) = Readings.of(values, ["a"] * 21 + ["b"]).notes
    assert "rows 0, 1, 2, 3, 4, 5, 6, 7 and 12 more" in note


def test_single_readings_are_dealt_into_trials_each_into_one() -> None:
    """Seven and four readings of a, five and five of b: two trials each, of two a setting or more."""
    settings = ["x"] * 7 + ["y"] * 4 + ["x"] * 5 + ["y"] * 5
    of = Readings.of(np.arange(21.0), ["a"] * 11 + ["b"] * 10, settings=settings)
    dealt = of.dealt(2)
    assert np.array_equal(dealt.values, of.values)
    assert len(dealt.trials) == 4
    for c in (0, 1):
        own = set(dealt.trial_index[dealt.class_index == c].tolist())
        assert own == {2 * c, 2 * c + 1}
        for trial in own:
            counts = dealt.counts(dealt.trial_index == trial)[c]
            assert counts.min() >= 2
    assert "4 trials were made up" in dealt.notes[-1]
    assert not np.array_equal(of.dealt(2, seed=2).trial_index, dealt.trial_index)
    with pytest.raises(PerceptionError, match="class 'a' has 4 readings at a setting; trials of 5"):
        of.dealt(5)


@pytest.mark.parametrize("nothing", [None, "", float("nan"), np.float64("nan")])
def test_a_row_without_a_name_is_an_error(nothing: object) -> None:
    with pytest.raises(PerceptionError, match="row 1 has no class"):
        Readings.of([1.0, 2.0], ["a", nothing])
    with pytest.raises(PerceptionError, match="row 0 has no trial"):
        Readings.of([1.0, 2.0], ["a", "b"], trials=[nothing, 1])


def test_what_does_not_fit_is_said() -> None:
    with pytest.raises(PerceptionError, match="3 readings of 1 columns, but 2 classes"):
        Readings.of([1.0, 2.0, 3.0], ["a", "b"])
    with pytest.raises(PerceptionError, match="names"):
        Readings.of([1.0, 2.0], ["a", "b"], columns=["x", "y"])
    with pytest.raises(PerceptionError, match="two are the least"):
        Readings.of([1.0, 2.0], ["a", "a"])
    with pytest.raises(PerceptionError, match="no reading is left"):
        Readings.of([np.nan, np.nan], ["a", "b"])
    with pytest.raises(PerceptionError, match="shape"):
        Readings.of([], [])
