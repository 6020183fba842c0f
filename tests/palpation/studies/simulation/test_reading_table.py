from typing import Any

import numpy as np
import pytest

from palp_core.methods import find
from palp_core.palpation.mechanics import Scene
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.studies.simulation.reading_table import (
    Gel,
    ReadingTable,
    measured,
    read,
    scene_of,
    sweep_torque,
    tabulate,
)


@pytest.fixture(scope="module")
def felt() -> ReadingTable:
    return tabulate(Gel(depths_m=(0.004,), rings_m=(0.004, 0.016)), noisy_sweeps=200)


def ones(value: float, count: int = 1) -> np.ndarray:
    return np.full(count, value)


@pytest.mark.parametrize(("error_m", "height_m"), [(0.0, 0.0), (0.25e-3, -0.3e-3), (-0.6e-3, 0.9e-3)])
def test_the_table_is_the_sweep_it_stands_for(felt: ReadingTable, error_m: float, height_m: float) -> None:
    whole = read(sweep_torque(felt.gel, 0.004, 0.016 + error_m, height_m), felt.gel)
    at = np.array([0]), np.array([1])
    found = felt.reading(*at, ones(error_m), ones(height_m), ones(0.0))[0] - felt.bias[0, 1]
    assert found == pytest.approx(whole, rel=2e-4)


def test_noise_is_what_the_whole_chain_makes_of_it(felt: ReadingTable) -> None:
    rng, clean = np.random.default_rng(1), sweep_torque(felt.gel, 0.004, 0.016)
    whole = np.array([read(measured(clean, felt.gel, rng), felt.gel) for _ in range(400)])
    at = np.zeros(4000, dtype=np.int64)
    found = felt.reading(at, at + 1, ones(0.0, 4000), ones(0.0, 4000), rng.standard_normal(4000))
    assert found.mean() == pytest.approx(whole.mean(), abs=1.5e-6)
    assert found.std() == pytest.approx(whole.std(ddof=1), rel=0.2)


def test_slopes_are_differences(felt: ReadingTable) -> None:
    at, h = (np.array([0]), np.array([1])), 1e-6
    up = felt.reading(*at, ones(h), ones(0.0), ones(0.0))[0]
    down = felt.reading(*at, ones(-h), ones(0.0), ones(0.0))[0]
    assert felt.ring_slope()[0, 1] == pytest.approx((up - down) / (2 * h), rel=1e-3)
    high = felt.reading(*at, ones(0.0), ones(h), ones(0.0))[0]
    low = felt.reading(*at, ones(0.0), ones(-h), ones(0.0))[0]
    assert felt.height_slope()[0, 1] == pytest.approx((high - low) / (2 * h), rel=1e-3)


def test_a_stiffer_joint_and_a_higher_phantom_feel_more(felt: ReadingTable) -> None:
    assert felt.nominal()[0, 1] > 2.0 * felt.nominal()[0, 0]
    assert (felt.height_slope() > 0.0).all()


def test_the_register_is_asked_with_the_rings_and_what_the_joint_gives_way() -> None:
    """A soft gel under a stiff joint: there L2's peak is as wrong as its force."""
    soft, usual = Gel(modulus_pa=8e3), Gel()
    asked = scene_of(soft, 0.004).quantities()
    assert asked["ring_m"] == soft.rings_m
    assert asked["depth_per_tip"] == pytest.approx(0.004 / 0.006)
    assert np.min(asked["yielding"]) < 0.4
    bounds = [find("contact", "l2").bound("peak", scene_of(gel, 0.004).quantities()) for gel in (usual, soft)]
    assert [bound is not None and bound <= 0.02 for bound in bounds] == [True, False]


@pytest.mark.parametrize(("feature", "rung"), [("peak", "l2"), ("contrast", "l4")])
def test_tables_and_slopes_are_of_the_contact_model_that_the_feature_needs(
    feature: str, rung: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[str] = []

    def noted(name: str, *given: Any) -> ContactModel:
        used.append(name)
        return rung_model(name, *given)

    for module in ("session.filters", "studies.simulation.reading_table"):
        monkeypatch.setattr(f"palp_core.palpation.{module}.rung_model", noted)
    gel = Gel(depths_m=(0.004,), rings_m=(0.016,), feature=feature)
    sweep_torque(gel, 0.004, 0.016)
    height_slope(gel.depths_m, gel.rings_m, feature, Scene(ring_m=gel.rings_m))
    assert used == [rung, rung]
