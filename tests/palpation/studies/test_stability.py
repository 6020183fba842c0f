"""Each row of the stability table: its method fails where stated, its survivor does not, runs report it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import correlation

from palp_core.methods import outside, weigh
from palp_core.methods.choice import INACCURATE, UNAVAILABLE
from palp_core.palpation.mechanics import LayeredHertz, Phantom, Probe, Scene, solve, sweep
from palp_core.palpation.mechanics.contact import fem_failures
from palp_core.palpation.mechanics.equilibrium.dynamics import simulate, tanh_explicit
from palp_core.palpation.mechanics.equilibrium.finders import brent, continued_newton
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.limits import stage_step
from palp_core.palpation.mechanics.scene.guard import BARE_GEL_SHARE, sweep_guards
from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.stopping import BeliefStep, PaperGuarded, PaperVerbatim, StopState
from palp_core.palpation.perception.emg.emg import EmgChain
from palp_core.palpation.perception.signal.wavelet import denoise
from palp_core.palpation.perception.strategy import markov
from palp_core.palpation.perception.strategy.policies import MarkovPolicy
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.stability import algorithm, mechanics
from palp_core.palpation.studies.stability import study as stability
from palp_core.palpation.studies.stability.case import Case, Row, Symptoms, measure
from palp_core.palpation.studies.stability.mechanics import INDENTATION_M, SMOOTHED, friction_step_s, gel
from palp_core.palpation.studies.stability.study import CASES, markdown, measure_rows
from palp_core.units import Float64Array

STAGE_M = np.linspace(-0.03, 0.05, 41)
DOCS = Path(__file__).parents[3] / "docs" / "results" / "mechanics.md"
FAILS = {
    "newton_from_upright": "everywhere in the range",
    "fixed_point": "everywhere in the range",
    "force_of_the_last_sample": "everywhere in the range",
    "no_spring_no_weight": "up to",
    "several_equilibria": "up to 2",
    "leading_tip": "up to 0.1",
    "dead_load": "from 1",
    "stiffness_times_angle": "from 1",
    "explicit_friction": "from 0.6",
    "coarse_stage": "from 3",
    "winkler_incompressible": "from 0.49",
    "explicit_elements": "everywhere in the range",
}
"""Where methods fail of the values that --quick tries; what takes minutes is in ELEMENTS."""
ELEMENTS = ("linear_triangles", "iterative_solver", "truncated_block", "coarse_cells", "small_strain")


@pytest.fixture(scope="module")
def rows() -> dict[str, Row]:
    return {name: Row.of(CASES[name], measure(CASES[name], quick=True), quick=True) for name in FAILS}


@pytest.mark.parametrize("name", FAILS)
def test_the_method_fails_where_it_is_said_to_and_the_survivor_does_not(
    name: str, rows: dict[str, Row]
) -> None:
    assert rows[name].threshold.startswith(FAILS[name])
    assert rows[name].survived


@pytest.mark.slow
@pytest.mark.parametrize("name", ELEMENTS)
def test_elements_fail_somewhere_and_their_survivor_nowhere(name: str) -> None:
    row = Row.of(CASES[name], measure(CASES[name], quick=True), quick=True)
    assert row.fails_somewhere
    assert row.survived


@pytest.mark.slow
def test_the_whole_map_in_the_documentation_is_the_studys() -> None:
    assert markdown(measure_rows(mechanics.CASES, Runner())) in DOCS.read_text(encoding="utf-8")


def test_the_study_writes_a_row_a_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: CASES[name] for name in ("dead_load", "leading_tip", "T1", "T11")}
    monkeypatch.setattr(stability, "CASES", few)
    page = study("stability").run(tmp_path, quick=True)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("index.html", "stability.json", "stability.csv", "stability.md"),
    }
    text, lines = page.read_text(encoding="utf-8"), (tmp_path / "stability.md").read_text(encoding="utf-8")
    assert lines.count("\n") == 2 + len(few)
    assert all(name in text for name in few)
    assert "ABOVE THE LIMIT" not in text


# how a row is written


def a_row(failing: list[float], **more: Any) -> Row:
    values = np.arange(float(len(failing)))
    case = Case("c", "a", "b", "e", "s", float, float, 1.0, parameter="p", values=values)
    return Row.of(replace(case, **more), Symptoms(tuple(failing), (0.0,) * len(failing), "why"))


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
    assert a_row(failing).threshold == words


@pytest.mark.parametrize(
    ("failing", "rig", "fails"),
    [
        ([0.0, 0.0, 2.0], (1.2, 9.0), False),
        ([0.0, 0.0, 2.0], (1.6,), True),
        ([0.0, 0.0], (1.0,), False),
        ([2.0, 2.0], (), False),  # nothing of the rig's is varied
    ],
)
def test_a_row_knows_whether_it_fails_at_the_rig(
    failing: list[float], rig: tuple[float, ...], fails: bool
) -> None:
    assert a_row(failing, rig=rig).fails_at_the_rig is fails


# A failing region that nothing reports fails the build: each case's failing values, and what says so there.


def refuses(task: str, name: str, output: str, quantities: dict[str, float]) -> bool:
    """Return whether the register would never take a method there."""
    (own,) = [one for one in weigh(task, output, 1e9, quantities) if one.name == name]
    return own.mark in (INACCURATE, UNAVAILABLE)


def met(model: LayeredHertz, probe: Probe, ring_m: float) -> str:
    """Return what a rig's sweep reports."""
    return "; ".join(solve(model, probe, ring_m, INDENTATION_M, -0.03, 0.05).solved.guards)


def finders_lag(friction: float) -> bool:
    """Return whether every finder that can be taken keeps to the tip that lags."""
    lagging = Joint(gel(0.004), Probe(friction=friction), 0.0005, INDENTATION_M)
    return all(bool(np.all(one(lagging, STAGE_M[:1]) > 0.0)) for one in (continued_newton, brent))


def explicit_step_is_replaced(share: float) -> bool:
    step_s = share * friction_step_s()
    way_m = 3.0 * step_s * 0.0005
    setting = replace(SMOOTHED, step_s=step_s)
    moved = simulate(
        gel(0.004), Probe(), 0.016, INDENTATION_M, -0.03, -0.03 + way_m, 0.0005, setting, tanh_explicit
    )
    return any("coulomb_implicit took over" in words for words in moved.guards)


def small_strain_is_reported(pressed_mm: float) -> bool:
    pressed = replace(sweep(gel(0.004), Probe(), 0.016, 0.001, STAGE_M), guards=())
    deep = replace(pressed, indentation_m=np.full(len(STAGE_M), pressed_mm * 1e-3))
    return any("small strain" in words for words in sweep_guards(Phantom(), Probe(), "l4", deep))


SEEN: dict[str, Callable[[float], bool]] = {
    "no_spring_no_weight": lambda mm: "hardly held" in met(gel(0.004), Probe(tip_mass_kg=0.0), mm * 1e-3),
    "several_equilibria": lambda mm: "several equilibria" in met(gel(mm * 1e-3, 5e3), Probe(), 0.016),
    "leading_tip": finders_lag,
    "explicit_friction": explicit_step_is_replaced,
    "coarse_stage": lambda mm: "misses the peak" in stage_step(mm * 1e-3)[1],
    "small_strain": small_strain_is_reported,
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
def test_where_a_method_fails_the_register_refuses_it_or_a_guard_reports_it(
    name: str, rows: dict[str, Row]
) -> None:
    failing = rows[name].values[rows[name].failed]
    assert failing.size
    assert [float(value) for value in failing if not SEEN[name](float(value))] == []


def test_every_case_is_reported_or_nothing_that_a_run_can_use() -> None:
    varied = {case.name for case in mechanics.CASES}
    assert varied == {*FAILS, *ELEMENTS} == {*SEEN, *NOT_OFFERED}
    assert not set(SEEN) & set(NOT_OFFERED)
    unmarked = {case.name for case in mechanics.CASES if not case.rig}
    assert unmarked == {"dead_load", "stiffness_times_angle", "explicit_friction", "truncated_block"}


def test_small_strain_is_reported_from_before_it_fails_on_bare_gel() -> None:
    """The study finds a twentieth from 2.85 mm on."""
    assert [mm for mm in np.linspace(2.85, 6.0, 22) if not small_strain_is_reported(float(mm))] == []
    assert not small_strain_is_reported(2.6)


@pytest.mark.nightly
def test_where_small_strain_is_not_reported_it_does_not_fail() -> None:
    silent_m = BARE_GEL_SHARE * 0.006
    assert abs(fem_failures.small_strain_excess(np.array([silent_m]))[0]) < 0.05


def test_a_stage_step_that_misses_the_peak_is_replaced_and_the_record_says_so() -> None:
    table = solve(gel(0.004), Probe(), 0.016, 0.004, -0.03, 0.05, 0.008)
    assert any("misses the peak" in words for words in table.solved.guards)
    assert np.max(np.diff(table.solved.stage_m)) <= 0.001 + 1e-12
    assert stage_step(0.0005) == (0.0005, "")


def test_a_rung_outside_its_range_is_named_with_the_quantity_and_the_survivor() -> None:
    assert outside("contact", "l2", Scene().quantities()) == ""
    words = outside("contact", "l2", {**Scene().quantities(), "poisson": 0.3})
    assert "poisson = 0.3 is not in [0.45, 0.5]" in words
    assert "l4 survives" in words


# The published algorithm: its formula, put into the library in place of ours, is noticed.


def loop_of_algorithm_1(self: Any, step: BeliefStep) -> StopState:
    gamma = float(correlation(step.gain_before, step.gain))
    return StopState(np.asarray(gamma), converged=np.asarray(not gamma > self.threshold))


def densities_multiplied(self: Primitives, reading: float, setting_index: int, **_: Any) -> Float64Array:
    z = (reading - self.mean[:, setting_index]) / self.sd[:, setting_index]
    return np.asarray(np.log(np.exp(-0.5 * z * z)))


def relative_frequencies(counts: Float64Array, **_: Any) -> Float64Array:
    return np.asarray(counts / counts.sum(axis=0))


def without_a_floor(*values: Any, floor: float, **names: Any) -> Primitives:
    return Primitives(**{**vars(FIT(*values, floor=floor, **names)), "sd": np.zeros((2, 1)), "floor": 1e-300})


def rms_of_the_counts(self: EmgChain, state: Any, counts: Float64Array) -> tuple[Any, Float64Array]:
    return state, np.sqrt(np.convolve(counts**2, np.full(75, 1 / 75), mode="same"))


FIT = fit

MUTATIONS: dict[str, tuple[Any, str, Any]] = {
    "T1": (PaperVerbatim, "check", loop_of_algorithm_1),
    "T1b": (algorithm, "gain_vector", algorithm.naive_gain),
    "T1c": (PaperVerbatim, "check", loop_of_algorithm_1),
    "T2": (PaperVerbatim, "check", loop_of_algorithm_1),
    "T3": (PaperGuarded, "check", lambda self, step: PaperVerbatim(self.threshold).check(step)),
    "T4": (Primitives, "log_likelihood", densities_multiplied),
    "T5": (algorithm, "fit", without_a_floor),
    "T6": (markov, "transition_matrix", relative_frequencies),
    "T7": (markov, "stationary", lambda matrix: np.real(np.linalg.eig(matrix)[1][:, 0])),
    "T7b": (markov, "relaxation_time", lambda matrix: 1.0),
    "T8": (algorithm, "denoise", lambda values, **_: np.asarray(values)),
    "T8b": (algorithm, "peak", lambda *_, **__: SimpleNamespace(index=algorithm.naive_peak())),
    "T8c": (algorithm, "denoise", lambda values, **_: denoise(values, rule="approximation")),
    "T9": (algorithm, "MarkovPolicy", lambda **_: MarkovPolicy(reading="mean")),
    "T9c": (MarkovPolicy, "level_law", lambda self, mean: algorithm.printed_law()),
    "T10": (EmgChain, "step", rms_of_the_counts),
    "T10b": (algorithm, "to_levels", lambda high: algorithm.naive_levels()),
    "T11": (algorithm, "two_way", lambda *_, **__: 0.0005),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_the_naive_method_fails_ours_survives_and_its_formula_in_the_library_is_noticed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert measure(CASES[name]).of_method == (1.0,)
    assert measure(CASES[name]).of_survivor == (0.0,)
    where, attribute, naive = MUTATIONS[name]
    monkeypatch.setattr(where, attribute, naive)
    assert measure(CASES[name]).of_survivor == (1.0,)


def test_every_formula_that_is_shown_to_fail_is_tried_in_the_library() -> None:
    assert set(MUTATIONS) == {case.name for case in algorithm.CASES}
