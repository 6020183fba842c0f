"""What the measure of contact finds, against what is known of them."""

from __future__ import annotations

import pytest

from palp_core.errors import MechanicsError
from palp_core.methods import names
from palp_core.methods.measured import REFERENCE, Measured
from palp_core.palpation.mechanics import Scene
from palp_core.palpation.studies.measures.mechanics import RungVariant, measure_contact, variants

ONE_RING = Scene(ring_m=(0.016,))


def last(points: list[Measured]) -> dict[tuple[str, str, str], Measured]:
    """The last measurement of each."""
    return {(one.method, one.setting, one.output): one for one in points}


def test_rungs_are_held_against_the_reference_that_has_been_solved() -> None:
    points = list(measure_contact(ONE_RING, [RungVariant("l0"), RungVariant("l2")], references=("l2",)))
    found = last(points)
    assert found["l2", "", "peak"].condition == REFERENCE
    assert found["l2", "", "peak"].error == 0.0
    assert 0.0 < found["l0", "", "peak"].error < 0.01 < found["l0", "", "contrast"].error < 0.4
    assert all(one.cost_s > 0.0 and one.against == "L2" for one in points)
    assert [one.output for one in points[:3]] == ["peak", "contrast", "normal"]


def test_a_rung_that_cannot_be_set_up_says_so_and_no_reference_is_an_error() -> None:
    coarse = RungVariant("l4", "5 mm", (("cell_m", 0.005),))
    found = last(list(measure_contact(ONE_RING, [coarse, RungVariant("l2")], references=("l2",))))
    assert "cell" in found["l4", "5 mm", "peak"].fails
    assert found["l4", "5 mm", "peak"].error != found["l4", "5 mm", "peak"].error
    with pytest.raises(MechanicsError, match="no contact rung to hold others against"):
        list(measure_contact(ONE_RING, [coarse]))


def test_every_rung_is_measured_the_quick_ones_first_and_the_usual_one_of_each() -> None:
    offered = variants()
    assert {one.rung for one in offered} == set(names("contact"))
    assert [one.rung for one in offered][:2] == ["l0", "l2"]
    assert {one.rung for one in offered if one.usual} == set(names("contact"))
    finest = [one.resolution for one in offered if one.rung == "l4"][-1]
    assert finest == "0.5 mm"


@pytest.mark.nightly
def test_all_rungs_of_the_published_scene_are_held_against_the_finest_cells() -> None:
    found = last(list(measure_contact(Scene())))
    assert {one.against for one in found.values()} == {"L4 0.5 mm"}
    assert found["l2", "", "peak"].error < 0.01
    assert found["l4", "1 mm", "peak"].error < 0.005
