"""The study ``frontier``: schemes on the same trials, failing where they fail, and the page."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from scipy.stats import norm

from nodes.experiment_plan import ExperimentParams
from palp_core.palpation.perception.belief.stopping import PosteriorThreshold
from palp_core.palpation.studies import session as simulation
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.frontier import study as frontier
from palp_core.palpation.studies.frontier.charts import frontier_chart
from palp_core.palpation.studies.frontier.limits import fano_accuracy, wald_accuracy
from palp_core.palpation.studies.frontier.study import (
    compare_schemes,
    depth_case,
    depth_rows,
    scheme_rows,
)
from palp_core.palpation.studies.plan import PAPER_PROTOCOL, SWIFT, Conditions, Gel
from palp_core.palpation.studies.robustness.cases import DIFFERENCES
from palp_core.palpation.studies.schemes import (
    SURE,
    TRACE,
    Case,
    Scheme,
    SchemeRun,
    lab_scheme,
    run_session,
)
from palp_core.palpation.studies.session import Stopwatch, WorldPlan, begin
from palp_core.palpation.studies.trace_table import TraceTable
from palp_core.palpation.studies.trials import model_of, run_trace_trials, settings_of
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array

LAUNCH = Path(__file__).parents[3] / "launch"
RINGS = Gel(rings_m=(0.004, 0.016), reading=TRACE)
PLAN = WorldPlan(
    world=LAB,
    conditions=Conditions(training=25, trials=20, specimens="other", phantoms=3, mounting="each_trial"),
    gel=RINGS,
)
UNIFORM = lab_scheme("contrast", "uniform", "threshold")
WHOLE = [lab_scheme(reading, "fixed_best", "threshold") for reading in ("peak", "contrast", TRACE)]
PAPERS_RULE = lab_scheme(TRACE, "fixed_best", "paper")


def ended(plan: WorldPlan, seed: tuple[int, ...], *schemes: Scheme) -> dict[str, SchemeRun]:
    return run_session(Case("lab", plan, schemes), seed)


@pytest.fixture(scope="module")
def whole() -> dict[str, SchemeRun]:
    """What schemes of whole sweeps did in a session."""
    return ended(PLAN, (3, 4), *WHOLE, UNIFORM, PAPERS_RULE)


@pytest.mark.usefixtures("whole")  # its contact models are set up
def test_a_decision_in_the_sweep_is_that_of_the_whole_sweep_sooner() -> None:
    stiff = replace(RINGS, rings_m=RINGS.rings_m[1:])
    session = begin(replace(PLAN, gel=stiff, path_m=SWIFT.path_m), (3, 1))
    model, ring = model_of(session, settings_of(session)), np.zeros(60, dtype=np.int64)
    early, late = (
        run_trace_trials(session, model, protocol, ring, PosteriorThreshold(SURE))
        for protocol in (SWIFT, replace(SWIFT, in_sweep=False))
    )
    assert early.correct.mean() > 0.9
    assert early.seconds.mean() < 0.9 * late.seconds.mean()
    assert (early.confidence[early.decided] >= 0.99).all()
    once = early.probes == 1
    assert (early.seconds[once] <= late.seconds.min() + 1e-12).all()


def test_the_swift_protocol_and_the_defaults_are_those_of_the_launch_file() -> None:
    args = yaml.safe_load((LAUNCH / "parts/experiment.yaml").read_text(encoding="utf-8"))["args"]
    told = args["protocol"]["sets"]["swift"]
    assert (told["from_m"], told["to_m"]) == SWIFT.path_m
    assert told["lift_mm"] == pytest.approx(SWIFT.lift_m * 1e3)
    assert (told["rehome"], told["stop_value"]) == ("never", SURE)
    assert not SWIFT.rehome
    for name in ("mounting", "specimens"):
        assert {getattr(one(), name) for one in (Conditions, ExperimentParams)} == {args[name]["default"]}


def test_a_whole_sweep_of_the_paper_takes_what_the_stage_takes() -> None:
    way_m = np.array([0.08])
    assert PAPER_PROTOCOL.sweep_s(way_m)[0] == pytest.approx(4.14, abs=0.005)
    assert PAPER_PROTOCOL.back_s(way_m)[0] == pytest.approx(3.74, abs=0.01)
    assert SWIFT.sweep_s(np.array([0.04]))[0] < 2.2


@pytest.mark.slow
def test_the_most_bits_a_second_are_not_at_the_softest_ring() -> None:
    (done,) = ended(PLAN, (3, 2), lab_scheme(TRACE, "information_gain", "threshold")).values()
    assert done.ended.correct.mean() > 0.9
    assert done.ended.probes.mean() < 2.0


@pytest.mark.slow
def test_friction_ruins_the_peak_and_neither_contrast_nor_trace() -> None:
    schemes = (
        lab_scheme("peak", "fixed_best", "paper"),
        lab_scheme("contrast", "fixed_best", "threshold"),
        lab_scheme(TRACE, "fixed_best", "threshold", "swift"),
    )
    found = ended(replace(WorldPlan(), **DIFFERENCES["friction -20%"]), (23, 1, 0), *schemes).values()
    peak, contrast, trace = (run.ended.correct.mean() for run in found)
    assert peak < 0.8
    assert contrast > 0.95
    assert trace > 0.95


def test_the_papers_stop_rule_takes_two_sweeps_of_a_trace_and_a_threshold_one(
    whole: dict[str, SchemeRun],
) -> None:
    """It compares the gains of two readings, however sure the first has made the belief."""
    paper, threshold = whole[PAPERS_RULE.name].ended, whole["trace, fixed_best, threshold"].ended
    assert paper.probes.min() == 2
    assert threshold.probes.min() == 1
    assert paper.correct.mean() > 0.9
    assert (threshold.confidence[threshold.decided] >= 0.99).all()
    assert all(np.array_equal(run.ended.depth, paper.depth) for run in whole.values())


@pytest.fixture
def coarse_depths(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarser grid than the study's, with nodules at two of its depths."""
    grid_m = tuple(np.linspace(0.002, 0.008, 5).tolist())
    for name, value in (("GRID_M", grid_m), ("SWEEPS", (1, 2)), ("_DEPTH_TRIALS", 6)):
        monkeypatch.setattr(frontier, name, value)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_depths")
def test_every_scheme_tells_a_depth_after_one_sweep_and_more() -> None:
    """The contrast tells it better than the peak."""
    names = ("peak, uniform, threshold", "contrast, uniform, paper", "trace, fixed_best, threshold")
    schemes = [lab_scheme(*name.split(", ")) for name in names]
    case = depth_case("lab", replace(PLAN, gel=replace(RINGS, rings_m=(0.012, 0.016))), schemes)
    rows = depth_rows("lab", [run_session(case, (3, 8))] * 2)
    assert [(row["scheme"], row["sweeps"]) for row in rows] == [(name, n) for name in names for n in (1, 2)]
    for first, second in zip(rows[0::2], rows[1::2], strict=True):
        assert second["seconds"] > first["seconds"]
        assert first["ci"][0] <= first["rmse_m"] <= first["ci"][1]
        assert 0.0 < first["rmse_m"] < 1.5e-3
    assert rows[2]["rmse_m"] < rows[0]["rmse_m"]


def test_what_simulating_costs_is_no_part_of_deciding(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that goes on in the simulation only."""
    now_s, traces = [0.0], TraceTable.traces

    def take_long(table: TraceTable, *asked: Any) -> Float64Array:
        now_s[0] += 8.0
        return traces(table, *asked)

    def watched(plan: WorldPlan, seed: tuple[int, ...]) -> simulation.WorldSession:
        return replace(begin(plan, seed), simulating=Stopwatch(lambda: now_s[0]))

    monkeypatch.setattr("palp_core.palpation.studies.schemes.begin", watched)
    monkeypatch.setattr(TraceTable, "traces", take_long)
    for run in ended(PLAN, (3, 4), UNIFORM, WHOLE[2]).values():
        assert run.cpu_s == 0.0
    assert now_s[0] > 0.0


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


def test_the_chart_has_every_scheme_limits_a_cross_and_a_front(whole: dict[str, SchemeRun]) -> None:
    fixed = "contrast, fixed_best, threshold"
    runs = [{name: whole[name] for name in (fixed, UNIFORM.name)}] * 2
    rows = scheme_rows("lab", runs)
    assert [row["scheme"] for row in rows] == [fixed, UNIFORM.name]
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
    assert [row[1] for row in chart.rows] == [fixed, UNIFORM.name]


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_depths")
def test_the_study_writes_its_page_and_tables(tmp_path: Path) -> None:
    page = study("frontier").run(tmp_path / "out", quick=True)
    assert "no result" in page.read_text()
    rows = json.loads((tmp_path / "out" / "frontier.json").read_text())["rows"]
    best = max(rows, key=lambda row: row["accuracy"])
    assert best["accuracy"] > 0.97
