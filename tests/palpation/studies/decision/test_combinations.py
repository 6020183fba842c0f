import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from palp_core.palpation.perception.belief.stopping import FixedNumber, PaperVerbatim, PosteriorThreshold
from palp_core.palpation.perception.strategy.optimal_shared import shared_optimum
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.decision import combinations
from palp_core.palpation.studies.decision.combinations import (
    FILTERS,
    Combinations,
    mark_front,
    tradeoff_session,
)
from palp_core.palpation.studies.decision.front_chart import front_chart
from palp_core.palpation.studies.decision.limits import Limits, least_seconds, limits, what_stays
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import FIXED, SessionJob, begin_session, run_policy
from palp_core.palpation.studies.simulation.reading_table import Gel, ReadingTable, tabulate
from palp_core.palpation.studies.toolkit.parallel import seeds


@pytest.fixture(scope="module")
def felt() -> ReadingTable:
    return tabulate(Gel())


points = st.lists(st.tuples(st.floats(0, 10), st.floats(0, 1)), min_size=1, max_size=8)


@given(points)
@settings(max_examples=40, deadline=None)
def test_the_front_is_what_no_other_beats(found: list[tuple[float, float]]) -> None:
    rows: list[dict[str, Any]] = [{"probes": 1.0, "seconds": c, "accuracy": a} for c, a in found]
    mark_front(rows, "seconds")
    assert any(row["front_seconds"] for row in rows)
    for (cost, share), row in zip(found, rows, strict=True):
        beaten = any(c <= cost and a >= share and (c, a) != (cost, share) for c, a in found)
        assert row["front_seconds"] == (not beaten)


def test_a_guess_without_a_probe_is_not_on_the_front() -> None:
    rows = [
        {"probes": p, "seconds": 9.0 * p, "accuracy": a} for p, a in ((0.0, 0.33), (1.0, 0.9), (2.0, 0.8))
    ]
    mark_front(rows, "seconds")
    assert [row["front_seconds"] for row in rows] == [False, True, False]


def a_row(policy: str, seconds: float, accuracy: float) -> dict[str, Any]:
    return {
        **{"policy": policy, "stop": "fixed_1", "feature": "peak", "filter": "naive", "seconds": seconds},
        **{"probes": seconds / 10.0, "accuracy": accuracy, "front_probes": False},
    }


LIMITS = Limits(
    independent=(),
    chernoff_nats=0.5,
    shared=(),
    capacity_bits=1.0,
    fano=((1.0, 0.6),),
    wald=((1.0, 0.7),),
    wald_for=(4.0, 8.0, 16.0),
)


def test_the_front_is_a_line_with_named_points_and_all_else_is_faint() -> None:
    rows = [
        a_row("fixed_16", 10.0, 0.7),
        a_row("uniform", 20.0, 0.6),
        a_row("gain", 30.0, 0.9),
        a_row("again", 30.0, 0.9),
    ]
    mark_front(rows, "seconds")
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    chart = front_chart(rows, "seconds", LIMITS)
    chart.draw(figure)
    canvas.draw()
    (axes,) = figure.axes
    (line,) = [one for one in axes.get_lines() if one.get_linewidth() == 2.0]
    assert np.asarray(line.get_xydata()).tolist() == [[10.0, 0.7], [30.0, 0.9]]
    (cloud,) = axes.collections
    assert (cloud.get_alpha() or 1.0) < 0.5
    assert len(np.asarray(cloud.get_offsets())) == len(rows)
    names = [words.get_text() for words in figure.legends[0].get_texts()]
    assert names == ["1  fixed 16, fixed 1, peak, naive filter", "2  gain, fixed 1, peak, naive filter (+1)"]
    assert [words.get_text() for words in axes.texts] == ["1", "2"]
    assert not any(one.get_window_extent().overlaps(axes.bbox) for one in figure.legends)


def test_the_average_of_the_fixed_positions_is_there_too(felt: ReadingTable) -> None:
    stops = {name: combinations.STOPS[name] for name in ("paper", "fixed_3")}
    of = Combinations(FIXED, stops, ("naive",))
    found = tradeoff_session(SessionJob(felt, Conditions(trials=4), (20, 1, 0)), of)
    for stop in stops:
        each = [found[policy, stop, "naive"].correct.mean() for policy in FIXED]
        assert found["fixed_average", stop, "naive"].correct.mean() == pytest.approx(np.mean(each))


@pytest.mark.slow
def test_independent_readings_are_a_limit_that_rises_with_probes() -> None:
    found = limits(tabulate(Gel()), Conditions(), trial_count=1000)
    for best in (found.independent, found.shared):
        by_probes = sorted(best, key=lambda one: one.probes)
        assert all(np.diff([one.accuracy for one in by_probes]) >= -1e-3)
        assert by_probes[-1].accuracy > 0.9
    assert found.chernoff_nats > 0.0
    assert found.independent[-1].accuracy > found.shared[-1].accuracy
    for limit in (found.fano, found.wald):
        assert all(np.diff([probes for probes, _ in limit]) > 0.0)
        assert all(np.diff([share for _, share in limit]) >= 0.0)
    assert found.wald_for == (4.0, 8.0, 16.0)


def test_information_gain_does_not_pass_the_optimum_of_its_own_model(felt: ReadingTable) -> None:
    """It once did, by two points: the optimum's settings were chosen beforehand, four of them at most."""
    conditions = Conditions(height_sd_m=0.1e-3, mounting="each_trial", trials=60, distribution="normal")
    (best,) = shared_optimum(what_stays(felt, conditions), [0.005], np.random.default_rng(1), trial_count=600)
    ended = [
        run_policy(
            "information_gain_latent",
            begin_session(felt, conditions, seed),
            PosteriorThreshold(),
            filter_name="latent",
        )
        for seed in seeds(20, 1, 6)
    ]
    right, probes = (np.mean([getattr(one, key) for one in ended]) for key in ("correct", "probes"))
    assert right - 0.005 * probes <= best.accuracy - 0.005 * best.probes + 0.01


def test_one_probe_takes_the_least_seconds_and_each_further_one_a_move_and_a_sweep(
    felt: ReadingTable,
) -> None:
    session = begin_session(felt, Conditions(trials=4), (20, 1, 0))
    one = run_policy("fixed_16", session, FixedNumber(1))
    assert one.seconds == pytest.approx(least_seconds(1.0))
    assert least_seconds(2.0) - least_seconds(1.0) == pytest.approx(9.0)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tradeoff")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(combinations, "UNKNOWN", Conditions(mounting="each_trial", trials=4))
        patch.setattr(combinations, "POLICIES", ("fixed_16", "uniform", "information_gain_latent"))
        patch.setattr(combinations, "STOPS", {"paper": PaperVerbatim()})
        study("decision-limits").run(folder, quick=True)
    return folder


@pytest.mark.slow
def test_every_combination_is_a_row_with_its_calibration(out: Path) -> None:
    report = json.loads((out / "decision_limits.json").read_text(encoding="utf-8"))
    keys = {(r["policy"], r["stop"], r["feature"], r["filter"]) for r in report["rows"]}
    assert len(keys) == len(report["rows"]) == 3 * 1 * 2 * len(FILTERS)
    for row in report["rows"]:
        assert {"accuracy", "ci", "probes", "seconds", "ece"} <= set(row)
    assert any(row["front_probes"] for row in report["rows"])


@pytest.mark.slow
def test_the_page_says_that_a_quick_run_is_no_result(out: Path) -> None:
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "Run with --quick: no result" in page
    assert "on 2 common sessions" in page


@pytest.mark.slow
def test_the_reference_rung_agrees_with_itself_and_one_rung_is_chosen(out: Path) -> None:
    rungs = json.loads((out / "decision_limits.json").read_text(encoding="utf-8"))["rungs"]
    assert all(r["agreement"] == 1.0 for r in rungs if r["rung"] == "l4" and not r["unstable"])
    assert {r["rung"] for r in rungs if r["chosen"]}
    assert {r["rung"] for r in rungs} == {"l0", "l2", "l4", "l5"}
    for row in rungs:
        assert (row["agreement"] is None) <= bool(row["words"])
        assert row["unstable"] == bool(row["words"])
    assert {"accuracy_against_probes", "accuracy_against_seconds", "decision_calibration"} <= {
        path.stem for path in out.glob("*.png")
    }
