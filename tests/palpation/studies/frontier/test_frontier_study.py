"""The studies of the frontier: schemes on equal luck, failing where they fail, and pages of both."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from scipy.stats import norm

from nodes.experiment_plan import ExperimentParams
from palp_core.palpation.session.plan import Specimens
from palp_core.palpation.studies.catalogue import OPTIONS, study
from palp_core.palpation.studies.frontier import depth_error, tables
from palp_core.palpation.studies.frontier.frontier_charts import frontier_chart
from palp_core.palpation.studies.frontier.limits import fano_accuracy, wald_accuracy
from palp_core.palpation.studies.frontier.protocols import PAPER_PROTOCOL, SWIFT
from palp_core.palpation.studies.frontier.schemes import SURE, DepthTask, Scheme, run_plan, run_schemes
from palp_core.palpation.studies.frontier.study import GEL_SCHEMES, gel_rows
from palp_core.palpation.studies.frontier.tables import compare_schemes, scheme_rows
from palp_core.palpation.studies.frontier.trace_trials import (
    KeepRing,
    MostInformation,
    model_of,
    run_trace_trials,
    settings_of,
)
from palp_core.palpation.studies.robustness.differences import WorldDifference, apply_difference
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.session import (
    Stopwatch,
    WorldPlan,
    WorldSession,
    begin,
)
from palp_core.palpation.studies.simulation.trace_table import TraceTable
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array

LAUNCH = Path(__file__).parents[4] / "launch"
RINGS = Gel(rings_m=(0.004, 0.016), reading="trace")
PLAN = WorldPlan(
    world=LAB,
    conditions=Conditions(training=25, trials=20, specimens="other", phantoms=3, mounting="each_trial"),
    gel=RINGS,
)


@pytest.fixture(scope="module")
def whole() -> WorldSession:
    """A session of whole sweeps."""
    return begin(PLAN, (3, 4))


def test_a_decision_in_the_sweep_is_that_of_the_whole_sweep_sooner() -> None:
    stiff = replace(RINGS, rings_m=RINGS.rings_m[1:])
    session = begin(replace(PLAN, gel=stiff, path_m=SWIFT.path_m), (3, 1))
    model = model_of(session, settings_of(session))
    early = run_trace_trials(session, model, SWIFT, selector=KeepRing(0))
    late = run_trace_trials(session, model, replace(SWIFT, in_sweep=False), selector=KeepRing(0))
    assert early.ended.correct.mean() > 0.9
    assert early.ended.seconds.mean() < 0.9 * late.ended.seconds.mean()
    assert (early.ended.confidence[early.ended.decided] >= 0.99).all()
    assert (early.way_m <= late.way_m[0] + 1e-12).all()


def test_the_swift_protocol_is_that_of_the_launch_files() -> None:
    told = yaml.safe_load((LAUNCH / "parts/experiment.yaml").read_text(encoding="utf-8"))["args"]["protocol"][
        "sets"
    ]["swift"]
    assert (told["from_m"], told["to_m"]) == SWIFT.path_m
    assert told["lift_mm"] == pytest.approx(SWIFT.lift_m * 1e3)
    assert (told["rehome"], told["stop_value"]) == ("never", SURE)
    assert not SWIFT.rehome


def test_mounting_and_specimens_have_one_default_in_launch_files_and_studies() -> None:
    args = yaml.safe_load((LAUNCH / "parts/experiment.yaml").read_text(encoding="utf-8"))["args"]
    for name in ("mounting", "specimens"):
        usual = {getattr(one(), name) for one in (Conditions, ExperimentParams)} | {OPTIONS[name]}
        assert usual == {args[name]["default"]}
    assert tuple(args["specimens"]["choices"]) == get_args(Specimens)


@pytest.mark.slow
def test_the_most_bits_a_second_are_not_at_the_softest_ring() -> None:
    session = begin(PLAN, (3, 2))
    model = model_of(session, settings_of(session))
    done = run_trace_trials(
        session, model, PAPER_PROTOCOL, selector=MostInformation(RINGS.rings_m, PAPER_PROTOCOL)
    )
    assert done.ended.correct.mean() > 0.9
    assert done.ended.probes.mean() < 2.0


@pytest.mark.slow
def test_friction_ruins_the_peak_and_neither_contrast_nor_trace() -> None:
    schemes = (
        Scheme("peak", "fixed_best", "paper"),
        Scheme("contrast", "fixed_best", "threshold"),
        Scheme("trace", "fixed_best", "threshold", "swift"),
    )
    less = apply_difference(WorldPlan(), WorldDifference("", (("friction", -0.2),)))
    found = {n: run.ended.correct.mean() for n, run in run_plan(less, (23, 1, 0), schemes=schemes).items()}
    assert found[schemes[0].name] < 0.8
    assert found[schemes[1].name] > 0.95
    assert found[schemes[2].name] > 0.95


@pytest.mark.slow
def test_schemes_of_one_session_meet_the_same_trials() -> None:
    runs = run_schemes(
        lambda protocol: begin(replace(PLAN, path_m=protocol.path_m), (3, 3)),
        (Scheme("peak", "uniform", "paper"), Scheme("trace", "uniform", "threshold", "swift")),
    )
    first, second = (run.ended for run in runs.values())
    assert np.array_equal(first.depth, second.depth)


def test_the_papers_stop_rule_takes_two_sweeps_of_a_trace_and_a_threshold_one(whole: WorldSession) -> None:
    """It compares the gains of two readings, however sure the first has made the belief."""
    schemes = tuple(Scheme("trace", "fixed_best", rule) for rule in ("paper", "threshold"))
    runs = run_schemes(lambda _: whole, schemes)
    paper, threshold = (run.ended for run in runs.values())
    assert paper.probes.min() == 2
    assert threshold.probes.min() == 1
    assert paper.correct.mean() > 0.9
    assert (threshold.confidence[threshold.decided] >= 0.99).all()


@pytest.mark.slow
def test_a_depth_in_millimetres_is_told_better_by_the_contrast_than_by_the_peak() -> None:
    grid_m = (0.002, 0.003, 0.004, 0.006, 0.008)
    few = replace(PLAN, conditions=replace(PLAN.conditions, trials=12), test_depths_m=grid_m)
    schemes = tuple(Scheme(reading, "fixed_best", "threshold") for reading in ("peak", "contrast"))
    runs = run_schemes(lambda _: begin(few, (3, 5)), schemes, DepthTask(grid_m, 2))
    off_mm = {}
    for name, run in runs.items():
        assert (run.ended.probes == 2).all()
        off_mm[name] = 1e3 * np.abs(run.ended.expected_m[:, -1] - np.asarray(grid_m)[run.ended.depth]).mean()
    assert off_mm[schemes[1].name] < 0.6 * off_mm[schemes[0].name]


@pytest.fixture
def coarse_depths(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarser grid than the study's, with nodules at two of its depths."""
    grid_m = tuple(np.linspace(0.002, 0.008, 5).tolist())
    for name, value in (("GRID_M", grid_m), ("TRUE_M", grid_m[1::2]), ("SWEEPS", (1, 2)), ("_TRIALS", 6)):
        monkeypatch.setattr(depth_error, name, value)
    monkeypatch.setattr(tables, "SWEEPS", (1, 2))


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_depths")
def test_every_scheme_tells_a_depth_after_one_sweep_and_more() -> None:
    schemes = (Scheme("contrast", "uniform", "paper"), Scheme("trace", "fixed_best", "threshold"))
    plan = replace(PLAN, gel=replace(RINGS, rings_m=(0.012, 0.016)))
    found = depth_error.depth_errors(plan, (3, 8), schemes=schemes)
    assert set(found) == {(one.name, sweeps) for one in schemes for sweeps in (1, 2)}
    for one in schemes:
        first, second = found[one.name, 1], found[one.name, 2]
        assert second.seconds > first.seconds
        assert 0.0 < first.squared_m2 < (1.5e-3) ** 2
    rows = tables.depth_rows("lab", [found, found])
    assert [(row["scheme"], row["sweeps"]) for row in rows] == [(s.name, n) for s in schemes for n in (1, 2)]
    assert rows[0]["ci"][0] <= rows[0]["rmse_m"] <= rows[0]["ci"][1]


def test_what_simulating_costs_is_no_part_of_deciding(
    whole: WorldSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that goes on in the simulation only."""
    now_s, traces = [0.0], TraceTable.traces

    def take_long(table: TraceTable, *asked: Any) -> Float64Array:
        now_s[0] += 8.0
        return traces(table, *asked)

    session = replace(whole, simulating=Stopwatch(lambda: now_s[0]))
    monkeypatch.setattr(TraceTable, "traces", take_long)
    for scheme in (Scheme("contrast", "uniform", "threshold"), Scheme("trace", "fixed_best", "threshold")):
        assert run_schemes(lambda _: session, (scheme,))[scheme.name].cpu_s == 0.0
    assert session.simulating.seconds == now_s[0] > 0.0


@given(st.floats(0.0, 1.58), st.integers(3, 6))
@settings(max_examples=30, deadline=None)
def test_fano_permits_more_with_more_information_and_chance_with_none(bits: float, classes: int) -> None:
    assert fano_accuracy(0.0, classes) == pytest.approx(1.0 / classes, abs=1e-6)
    assert fano_accuracy(bits, classes) <= fano_accuracy(bits + 0.1, classes) + 1e-12
    assert fano_accuracy(np.log2(classes), classes) == 1.0
    assert fano_accuracy(1.016, 3) == pytest.approx(0.9, abs=1e-3)


def test_no_test_of_a_fixed_number_of_readings_beats_walds_bound() -> None:
    """Readings a standard deviation apart diverge by half a nat each."""
    for count in (1, 4, 9):
        assert wald_accuracy(0.5 * count) > norm.cdf(0.5 * np.sqrt(count))


def test_the_chart_has_every_scheme_limits_a_cross_and_a_front(whole: WorldSession) -> None:
    fixed, uniform = (Scheme("contrast", policy, "threshold") for policy in ("fixed_best", "uniform"))
    runs = [run_schemes(lambda _: whole, (fixed, uniform))] * 2
    rows = scheme_rows("lab", runs)
    assert [row["scheme"] for row in rows] == [fixed.name, uniform.name]
    assert any(row["front"] for row in rows)
    same = compare_schemes(runs, fixed, fixed)
    assert (same["difference"], same["times_fewer_seconds"]) == (0.0, 1.0)
    rows[0]["ece"], rows[1]["ece"] = 0.2, 0.01
    depths = [
        {**rows[0], "sweeps": sweeps, "seconds": 8.0 * sweeps, "rmse_m": 1e-3, "ci": [0.9e-3, 1.1e-3]}
        for sweeps in (1, 4)
    ]
    chart = frontier_chart(rows, depths, {"lab": [[3.0, 0.5, 0.6], [4.0, 0.9, 1.0]]})
    drawn = Figure()
    chart.draw(drawn)
    speed, error, cost = drawn.axes
    assert [axes.get_xlabel() for axes in drawn.axes] == [
        "seconds of the rig a decision",
        "seconds of the rig",
        "CPU a decision, ms",
    ]
    assert "mm" in error.get_ylabel()
    for axes in (speed, cost):
        crosses = [line.get_xdata() for line in axes.lines if line.get_marker() == "x"]
        assert len(crosses) == 1
    assert len([line for line in speed.lines if line.get_linestyle() in (":", "--")]) == 2
    assert [row[1] for row in chart.rows] == [fixed.name, uniform.name]


def test_a_filter_chooses_its_contact_model_by_what_it_reads_whatever_the_gel_is(whole: WorldSession) -> None:
    runs = [run_schemes(lambda _: whole, GEL_SCHEMES)]
    rows = gel_rows({"l2": runs, "l4": runs})
    assert [row["gel"] for row in rows] == ["l2"] * len(GEL_SCHEMES) + ["l4"] * len(GEL_SCHEMES)
    chosen = {(row["reading"], row["filter"]) for row in rows}
    assert chosen == {("peak", "l2"), ("contrast", "l4"), ("trace", "l4, l2")}
    assert set(whole.table.rungs) == {"l4", "l2"}  # what is felt has to be right all along the sweep


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_depths")
def test_the_study_writes_its_page_and_tables(tmp_path: Path) -> None:
    page = study("frontier").run(tmp_path / "out", quick=True)
    assert "no result" in page.read_text()
    rows = json.loads((tmp_path / "out" / "frontier.json").read_text())["rows"]
    best = max(rows, key=lambda row: row["accuracy"])
    assert best["accuracy"] > 0.97
