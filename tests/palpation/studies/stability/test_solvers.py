"""Each row of the stability table: the method fails where it states, and its survivor does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palp_core.methods import outside, weigh
from palp_core.methods.choice import INACCURATE, UNAVAILABLE
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, Scene, solve, sweep
from palp_core.palpation.mechanics.contact import fem_failures
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate, tanh_explicit
from palp_core.palpation.mechanics.equilibrium.finders import (
    brent,
    continued_newton,
)
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.limits import explicit_step_s, stage_step
from palp_core.palpation.mechanics.scene.guard import BARE_GEL_SHARE, sweep_guards
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.stability import elements
from palp_core.palpation.studies.stability.case import Case
from palp_core.palpation.studies.stability.elements import (
    element_cases,
    explicit_elements,
    fem_cases,
    small_strain,
)
from palp_core.palpation.studies.stability.joint import INDENTATION_M, gel, joint_cases
from palp_core.palpation.studies.stability.study import markdown, overview

STAGE_M = np.linspace(-0.03, 0.05, 41)


DOCS = Path(__file__).parents[4] / "docs" / "explanation" / "mechanics.md"


@pytest.fixture(scope="module")
def cases() -> dict[str, Case]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(elements, "fem_cases", lambda **_: [])
        return {case.name: case for case in (*joint_cases(quick=True), *element_cases(quick=True))}


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
    name: str, cases: dict[str, Case]
) -> None:
    case = cases[name]
    assert case.threshold.startswith(FAILS[name])
    assert case.survived


def a_case(failing: list[float]) -> Case:
    values = np.arange(float(len(failing)))
    return Case("c", "a", "b", "p", values, "s", np.array(failing), np.zeros(len(failing)), 1.0, "why")


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


def test_a_stage_step_that_misses_the_peak_is_replaced_and_the_record_says_so() -> None:
    table = solve(joint().model, Probe(), 0.016, 0.004, -0.03, 0.05, 0.008)
    assert any("misses the peak" in words for words in table.solved.guards)
    assert np.max(np.diff(table.solved.stage_m)) <= 0.001 + 1e-12
    assert stage_step(0.0005) == (0.0005, "")


def test_a_rung_outside_its_range_is_named_with_the_quantity_and_the_survivor() -> None:
    assert outside("contact", "l2", Scene().quantities()) == ""
    words = outside("contact", "l2", {**Scene().quantities(), "poisson": 0.3})
    assert "poisson = 0.3 is not in [0.45, 0.5]" in words
    assert "l4 survives" in words


def test_the_study_writes_a_row_a_case_and_one_chart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elements, "fem_cases", lambda **_: [])
    page = study("stability").run(tmp_path, quick=True)
    assert {path.name for path in tmp_path.iterdir()} == {
        "index.html", "stability.md", "stability.png", "stability.svg", "stability.csv",
    }  # fmt: skip
    text, rows = page.read_text(encoding="utf-8"), (tmp_path / "stability.md").read_text(encoding="utf-8")
    assert rows.count("\n") == 2 + len(FAILS) + 18
    assert all(f"stability -k {name}" in text for name in (*FAILS, "T1", "T11"))
    assert "ABOVE THE LIMIT" not in text
    assert "fails everywhere" not in rows


def drawn_axes(case: Case) -> Axes:
    figure = Figure()
    overview([case]).draw(figure)
    (axes,) = figure.axes
    return axes


def test_a_bar_has_a_scale_the_value_from_which_it_fails_and_a_mark_for_the_rig() -> None:
    case = replace(a_case([0.0, 0.0, 0.0, 2.0, 2.0]), rig=(1.0, 9.0))
    axes = drawn_axes(case)
    assert axes.get_title(loc="right") == "fails from 3"
    assert axes.get_xlabel() == "p"
    assert [tick.get_text() for tick in axes.get_xticklabels()][0::2] == ["0", "1", "2", "3", "4"]
    marks = {str(line.get_marker()): np.asarray(line.get_xdata()).tolist() for line in axes.get_lines()}
    assert marks == {"v": [1.0], ">": [4.0]}  # the second lies beyond what was tried
    failing = [
        one.get_window_extent().transformed(axes.transData.inverted()).x0
        for one in axes.patches
        if one.get_hatch()
    ]
    assert failing == pytest.approx([2.5, 3.5])


def test_a_case_says_whether_it_fails_at_the_rig() -> None:
    assert not replace(a_case([0.0, 0.0, 2.0]), rig=(1.2, 9.0)).fails_at_the_rig
    assert replace(a_case([0.0, 0.0, 2.0]), rig=(1.6,)).fails_at_the_rig
    assert not replace(a_case([0.0, 0.0]), rig=(1.0,)).fails_somewhere
    assert not a_case([2.0, 2.0]).fails_at_the_rig  # nothing of the rig's is varied


def test_a_bar_spreads_ratios_next_to_a_half() -> None:
    values = 0.5 - np.array([0.2, 0.01, 0.0001])
    case = replace(a_case([0.0, 0.0, 2.0]), values=values, axis="to_half", rig=(0.49,))
    axes = drawn_axes(case)
    at = {
        tick.get_text(): float(place)
        for tick, place in zip(axes.get_xticklabels(), axes.get_xticks(), strict=True)
    }
    assert at["0.49"] == pytest.approx(2.0)
    assert at["0.499"] - at["0.49"] == pytest.approx(1.0)


def test_every_case_says_where_the_rig_is_or_varies_nothing_of_it(cases: dict[str, Case]) -> None:
    unmarked = {name for name, case in cases.items() if not case.rig}
    assert unmarked == {"dead_load", "stiffness_times_angle", "explicit_friction"}


# A failing region that nobody sees fails the build: each case's failing values, and who says so there.


def refuses(task: str, name: str, output: str, quantities: dict[str, float]) -> bool:
    """Tell whether the register would never take a method there."""
    (own,) = [one for one in weigh(task, output, 1e9, quantities) if one.name == name]
    return own.mark in (INACCURATE, UNAVAILABLE)


def met(model: LayeredHertz, probe: Probe, ring_m: float) -> str:
    """Return what a rig's sweep says."""
    return "; ".join(solve(model, probe, ring_m, INDENTATION_M, -0.03, 0.05).solved.guards)


def finders_lag(friction: float) -> bool:
    """Tell whether every finder that can be taken keeps to the tip that lags."""
    lagging = Joint(gel(0.004), Probe(friction=friction), 0.0005, INDENTATION_M)
    return all(bool(np.all(one(lagging, STAGE_M[:1]) > 0.0)) for one in (continued_newton, brent))


def explicit_step_is_replaced(share: float) -> bool:
    model, probe, setting = gel(0.004), Probe(), Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0)
    start = sweep(model, probe, 0.016, INDENTATION_M, [-0.03, -0.029])
    unit_s = 3.0 * explicit_step_s(
        setting.inertia_kg_m2, 1e-3, probe.friction, float(start.normal_n[0]), probe.tip_m
    )
    step_s = share * unit_s
    way_m = 3.0 * step_s * 0.0005
    setting = Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0, step_s=step_s)
    moved = simulate(model, probe, 0.016, INDENTATION_M, -0.03, -0.03 + way_m, 0.0005, setting, tanh_explicit)
    return any("coulomb_implicit took over" in words for words in moved.guards)


def small_strain_is_said(pressed_mm: float) -> bool:
    pressed = replace(sweep(gel(0.004), Probe(), 0.016, 0.001, STAGE_M), guards=())
    deep = replace(pressed, indentation_m=np.full(len(STAGE_M), pressed_mm * 1e-3))
    return any("small strain" in words for words in sweep_guards(Phantom(), Probe(), "l4", deep))


SEEN: dict[str, Callable[[float], bool]] = {
    "no_spring_no_weight": lambda mm: "hardly held" in met(gel(0.004), Probe(tip_mass_kg=0.0), mm * 1e-3),
    "several_equilibria": lambda mm: "several equilibria" in met(gel(mm * 1e-3, 5e3), Probe(), 0.016),
    "leading_tip": finders_lag,
    "explicit_friction": explicit_step_is_replaced,
    "coarse_stage": lambda mm: "misses the peak" in stage_step(mm * 1e-3)[1],
    "small_strain": small_strain_is_said,
}

NOT_OFFERED = {
    "newton_from_upright": "runs take continued_newton",
    "fixed_point": "runs take continued_newton",
    "force_of_the_last_sample": "runs take continued_newton",
    "dead_load": "the stage is held at a height: no parameter presses by a load",
    "stiffness_times_angle": "Probe.joint_torque is the one law of the spring",
    "winkler_incompressible": "no rung is an elastic foundation",
    "linear_triangles": "the rungs' elements are Taylor-Hood",
    "iterative_solver": "the rungs solve directly",
    "truncated_block": "L4's layer is endless, in closed form",
    "coarse_cells": "L4 averages over its cells",
    "explicit_elements": "L4's compliance is condensed once",
}
"""Failing methods that no run can be made to use, neither by a parameter nor by the register."""


@pytest.mark.parametrize("name", sorted(set(SEEN) & set(FAILS)))
def test_where_a_method_fails_the_register_refuses_it_or_a_guard_says_so(
    name: str, cases: dict[str, Case]
) -> None:
    case = cases[name]
    failing = case.values[case.failed]
    assert failing.size
    assert [float(value) for value in failing if not SEEN[name](float(value))] == []


def test_every_case_is_seen_by_somebody_or_nothing_that_a_run_can_use(cases: dict[str, Case]) -> None:
    assert set(cases) == set(FAILS) <= set(SEEN) | set(NOT_OFFERED)
    assert not set(SEEN) & set(NOT_OFFERED)


def test_small_strain_is_said_from_before_it_fails_on_bare_gel() -> None:
    """The study finds a twentieth from 2.85 mm on."""
    assert [mm for mm in np.linspace(2.85, 6.0, 22) if not small_strain_is_said(float(mm))] == []
    assert not small_strain_is_said(2.6)


@pytest.mark.nightly
def test_where_small_strain_is_not_said_it_does_not_fail() -> None:
    silent_m = BARE_GEL_SHARE * 0.006
    assert abs(fem_failures.small_strain_excess(np.array([silent_m]))[0]) < 0.05
    case = small_strain(quick=True)
    assert all(SEEN["small_strain"](float(mm)) for mm in case.values[case.failed])


def test_explicit_elements_need_tens_of_thousands_of_steps_at_any_poissons_ratio() -> None:
    case = explicit_elements(quick=True)
    assert case.failed.all()
    assert case.survived


@pytest.mark.slow
def test_the_whole_map_in_the_documentation_is_the_studys() -> None:
    whole = [*joint_cases(quick=False), *element_cases(quick=False)]
    assert markdown(whole) in DOCS.read_text(encoding="utf-8")


@pytest.mark.slow
def test_each_case_of_elements_fails_somewhere_and_its_survivor_nowhere() -> None:
    found = fem_cases(quick=True)
    assert {case.name for case in found} | set(FAILS) == set(SEEN) | set(NOT_OFFERED)
    assert [case.name for case in found if not (case.failed.any() and case.survived)] == []
