"""The cheapest rung that is good enough, and an honest refusal where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import MethodError
from palp_core.mechanics import Bead, Phantom, contact_model
from palp_core.methods import choose, find


def test_the_default_scene_is_answered_by_l2_with_its_reason() -> None:
    model, choice = contact_model(Phantom(bead=Bead(depth_m=0.004)), 0.006)
    assert model.rung == choice.method.name == "l2"
    assert choice.bound <= 0.02
    assert "to be re-established" in choice.reason
    assert model.force(np.zeros(1), np.array([0.003]))[0] > 0.0


def test_bare_gel_is_answered_too() -> None:
    assert contact_model(Phantom(), 0.006)[0].reach_m == 0.0


@pytest.mark.parametrize("depth_m", [0.002, 0.004])
def test_contrast_over_a_shallow_bead_is_vouched_for_within_a_tenth(depth_m: float) -> None:
    assert contact_model(Phantom(bead=Bead(depth_m=depth_m)), 0.006, "contrast", 0.1)[1].bound == 0.1
    with pytest.raises(MethodError, match=r"10\.0% only"):
        contact_model(Phantom(bead=Bead(depth_m=depth_m)), 0.006, "contrast", 0.05)


def test_contrast_over_a_deep_bead_is_refused_and_a_finer_rung_is_named() -> None:
    with pytest.raises(MethodError, match=r"l4 would be the next finer one.*add a finer method"):
        choose("contact", "contrast", 0.1, Phantom(bead=Bead(depth_m=0.008)).scene())


@pytest.mark.parametrize("phantom", [Phantom(poisson=0.3), Phantom(height_m=0.01)])
def test_a_phantom_outside_the_valid_range_climbs(phantom: Phantom) -> None:
    with pytest.raises(MethodError, match="l2 vouches for no 'peak'"):
        contact_model(phantom, 0.006)


def test_a_deep_press_climbs() -> None:
    with pytest.raises(MethodError, match=r"indentation_m = 0\.0055"):
        contact_model(Phantom(), 0.006, indentation_m=0.0055)


def test_the_register_says_where_l2_fails_and_what_survives() -> None:
    declared = find("contact", "l2")
    assert "contrast" in declared.fails
    assert declared.survivor == "l4"
