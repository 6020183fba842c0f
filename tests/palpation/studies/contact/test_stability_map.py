"""Each row of the stability map: the method fails where it is said to, and its survivor does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import MechanicsError
from palp_core.methods import find, methods, outside
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, Scene, solve
from palp_core.palpation.mechanics.equilibrium.finders import continued_newton
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.limits import explicit_step_s, stage_step
from palp_core.palpation.studies.contact.case import FailureCase
from palp_core.palpation.studies.contact.cases_joint import joint_cases
from palp_core.palpation.studies.contact.cases_other import other_cases
from palp_core.palpation.studies.contact.map import METHODS, MapVerdict, judge, map_chart, points

STAGE_M = np.linspace(-0.03, 0.05, 41)


@pytest.fixture(scope="module")
def cases() -> dict[str, FailureCase]:
    return {case.name: case for case in (*joint_cases(quick=True), *other_cases(quick=True))}


FAILS = {
    "newton_from_upright": "everywhere in the range",
    "fixed_point": "everywhere in the range",
    "force_of_the_last_sample": "everywhere in the range",
    "no_spring_no_weight": "up to",
    "several_equilibria": "up to 2.4",
    "leading_tip": "up to 0.1",
    "dead_load": "from 1.1",
    "stiffness_times_angle": "from 1",
    "explicit_friction": "from 0.65",
    "coarse_stage": "from 4.7",
    "winkler_incompressible": "from 0.49",
}


@pytest.mark.parametrize("name", FAILS)
def test_the_method_fails_where_it_is_said_to_and_the_survivor_does_not(
    name: str, cases: dict[str, FailureCase]
) -> None:
    case = cases[name]
    assert case.threshold.startswith(FAILS[name])
    assert case.survived


def test_every_case_is_tested(cases: dict[str, FailureCase]) -> None:
    assert set(cases) == set(FAILS)


def a_case(failing: list[float]) -> FailureCase:
    values = np.arange(float(len(failing)))
    return FailureCase("c", "a", "b", "p", values, "s", np.array(failing), np.zeros(len(failing)), 1.0, "why")


@pytest.mark.parametrize(
    ("failing", "words"),
    [
        ([0.0, 0.0], "nowhere in the range"),
        ([2.0, np.inf], "everywhere in the range"),
        ([0.0, 0.0, np.nan], "from 2"),
        ([2.0, 2.0, 0.0], "up to 1"),
        ([2.0, 0.0, 2.0, 2.0, 0.0], "0 to 0, 2 to 3"),
    ],
)
def test_a_threshold_is_put_into_words(failing: list[float], words: str) -> None:
    assert a_case(failing).threshold == words


def joint(ring_m: float = 0.008) -> Joint:
    return Joint(LayeredHertz(Phantom(bead=Bead(depth_m=0.004)), 0.006), Probe(), ring_m, 0.004)


@pytest.mark.parametrize("name", [one.name for one in methods("equilibrium")])
def test_only_a_finder_that_brackets_the_root_follows_the_tip_all_the_way(name: str) -> None:
    truth = continued_newton(joint(), STAGE_M)
    try:
        found = find("equilibrium", name).target(joint(), STAGE_M)
    except (MechanicsError, ValueError, FloatingPointError):
        found = np.full(len(STAGE_M), np.nan)
    followed = bool(np.all(np.abs(found - truth) <= 1e-6))
    assert followed == (name in ("bracketed_newton", "brentq"))


def test_a_stage_step_that_misses_the_peak_is_replaced_and_the_record_says_so() -> None:
    table = solve(joint().model, Probe(), 0.016, 0.004, -0.03, 0.05, 0.008)
    assert any("misses the peak" in words for words in table.solved.guards)
    assert np.max(np.diff(table.solved.stage_m)) <= 0.001 + 1e-12
    assert stage_step(0.0005) == (0.0005, "")


def test_an_explicit_step_is_a_third_of_the_linear_limit() -> None:
    assert explicit_step_s(1e-5, 1e-3, 0.3, 0.5, 0.07) == pytest.approx(2e-8 / (0.15 * 0.0049) / 3)
    assert explicit_step_s(1e-5, 1e-3, 0.3, 0.0, 0.07) == np.inf


def test_a_rung_outside_its_range_is_named_with_the_quantity_and_the_survivor() -> None:
    assert outside("contact", "l2", Scene().quantities()) == ""
    words = outside("contact", "l1", Scene().quantities())
    assert "poisson = 0.49 is not in [0, 0.45]" in words
    assert "l2 survives" in words


def test_the_users_map_covers_the_grid_and_draws(tmp_path: Path) -> None:
    from palp_core.palpation.reporting.charts import save

    grid = list(points(quick=True))
    assert len(grid) == 48
    assert len(list(points(quick=False))) == 700
    found = [judge(point) for point in grid[::5]]
    assert all(set(verdict.safe) == set(METHODS) for verdict in found)
    share = {name: np.mean([verdict.safe[name] for verdict in found]) for name in METHODS}
    assert share["plain_newton"] < 0.5
    assert share["fixed_point"] < 0.5
    assert share["lagging_start"] == 1.0
    whole = [MapVerdict(point, dict.fromkeys(METHODS, point.depth_m > 0.002)) for point in grid]
    chart = map_chart(whole, "small_strain")
    save(chart, tmp_path, svg=True)
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".svg", ".csv"}
    assert len(chart.rows) == 48
    assert "Safe in 50 % of 48 scenes" in chart.caption
