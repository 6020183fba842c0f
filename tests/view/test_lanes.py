"""The timeline as it is drawn: lanes, marks, ticks."""

from __future__ import annotations

import pytest

from palp_core.view.source.lanes import SIGNS, Lane, axis, lanes
from palp_core.view.source.timeline import Happening


def happened(at_s: float, node: str = "", level: str = "ok", kind: str = "activated") -> Happening:
    return Happening(at_s, kind, node, "words", level)


def test_each_node_has_a_lane_and_the_graph_the_first() -> None:
    found = lanes([happened(9.0, "torque"), happened(5.0), happened(1.0, "emg")], 0.0, 10.0)
    assert [(lane.name, [mark.at for mark in lane.marks]) for lane in found] == [
        ("graph", [50.0]), ("/emg", [10.0]), ("/torque", [90.0]),
    ]  # fmt: skip


def test_what_is_too_near_together_is_one_mark_as_bad_as_the_worst_of_it_that_leads_to_all_rows() -> None:
    rows = [
        happened(5.002, "a", "ok"),
        happened(5.001, "a", "error", "swap_failed"),
        happened(5.0, "a", "warn"),
    ]
    (lane,) = lanes(rows, 0.0, 100.0)
    (mark,) = lane.marks
    assert (mark.rows, mark.level, mark.sign) == ([0, 1, 2], "error", SIGNS["error"] + "3")
    assert mark.words == "5.000 s: activated and 2 more"


def test_of_a_window_only_what_lies_in_it_is_drawn_and_rows_keep_their_numbers() -> None:
    (lane,) = lanes([happened(90.0, "a"), happened(10.0, "a")], 80.0, 100.0)
    assert [(mark.rows, mark.at) for mark in lane.marks] == [([0], 50.0)]
    assert lanes([happened(10.0, "a")], 80.0, 100.0) == []


def test_a_level_is_told_by_shape_too() -> None:
    rows = [happened(1.0, "a", "ok"), happened(5.0, "a", "warn"), happened(9.0, "a", "error")]
    (lane,) = lanes(rows, 0.0, 10.0)
    assert len({mark.sign for mark in lane.marks}) == 3


@pytest.mark.parametrize(
    ("begin_s", "end_s", "first", "last"),
    [(0.0, 0.0, "0", 7), (0.0, 0.35, "0", 8), (3540.0, 3600.0, "3540", 8), (0.0, 86_400.0, "0", 10)],
)
def test_an_axis_has_few_round_times_from_before_the_first_to_after_the_last(
    begin_s: float, end_s: float, first: str, last: int
) -> None:
    low_s, high_s, ticks = axis(begin_s, end_s)
    assert low_s <= begin_s <= end_s <= high_s
    assert (ticks[0].text, ticks[0].at, ticks[-1].at) == (first, 0.0, 100.0)
    assert 2 <= len(ticks) <= last + 1


def test_nothing_that_has_happened_has_no_lane() -> None:
    empty: list[Lane] = lanes([], 0.0, 1.0)
    assert empty == []
