"""The paper's page: every figure and table with ours next to it, its statistics, and its numbers."""

import csv
import json
import re
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy import stats

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.paper import cases
from palp_core.palpation.studies.paper import study as paper_study
from palp_core.palpation.studies.paper.cases import why_report
from palp_core.palpation.studies.paper.statistics import (
    correlate_trials,
    count_sessions,
    iterations,
)
from palp_core.palpation.studies.paper.study import paper_sessions, results
from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import POLICIES
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.trials import Outcomes
from tests.support.drawing import render_nothing

WHY = {
    "cell": "only H1", "accuracy": 0.8, "ci": [0.7, 0.9], "progress": 0.1, "progress_ci": [0.0, 0.2],
    "probes": 2.0, "ece": 0.1,
}  # fmt: skip


def run_few(folder: Path, scene_sessions: int) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        if not scene_sessions:
            render_nothing(patch)
        patch.setattr(paper_study, "QUICK", (2, scene_sessions, 0, 6))
        patch.setattr(paper_study, "why_report", lambda *_: {"hypotheses": {"H1": "one"}, "cells": [WHY]})
        page = study("paper").run(folder, quick=True)
    assert page == folder / "index.html"
    return folder


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_few(tmp_path_factory.mktemp("paper"), 0)


@pytest.fixture(scope="module")
def report(out: Path) -> Any:
    return json.loads((out / "paper.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(out: Path) -> str:
    return (out / "index.html").read_text(encoding="utf-8")


def test_every_policy_is_reported_with_what_a_reader_needs(report: Any) -> None:
    assert set(report["policies"]) == {*POLICIES, "fixed_average"}
    for line in report["policies"].values():
        assert {"accuracy", "ci", "per_depth", "probes", "seconds", "ece", "sessions"} <= set(line)
        low, high = line["ci"]
        assert 0.0 <= low <= line["accuracy"] <= high <= 1.0
        assert set(line["per_depth"]) == {"2", "4", "8"}
        assert line["sessions"] == 2
    took = report["iterations"]["by_depth"]
    mean = np.mean([one["value"] for one in took.values()])
    assert mean == pytest.approx(report["policies"]["markov"]["probes"])


def test_every_figure_and_table_is_on_the_page(out: Path, page: str, report: Any) -> None:
    figures = [f"Figure {number}" for number in ("3", "4", "5", "7(b)", "8", "9", "10", "11", "12")]
    for words in (
        *figures,
        "Tables 3 and 4",
        "Table 5",
        "Table 6",
        "How many sessions a comparison takes",
        "Why would a fixed stiffness make no progress?",
        "published numbers",
        "reconstruction",
        "With 2 sessions no p among 11 comparisons can be below 1",
        f"{report['iterations']['by_depth']['8']['value']:.2f} at 8 mm",
    ):
        assert words.lower() in page.lower()
    pictures = sorted(path.stem for path in out.glob("*.png"))
    assert len(pictures) >= 8
    assert {path.stem for path in out.glob("*.csv")} == set(pictures)
    assert all(f"{stem}.png" in page for stem in pictures)


def test_figure_12_has_the_best_fixed_position_beside_the_papers_bars(out: Path, report: Any) -> None:
    with (out / "figure_12_comparison.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["experiment"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["human", "fixed_average", "fixed_best", "markov"]
    assert float(rows["fixed_best"]["ours"]) == report["policies"]["fixed_best"]["accuracy"]
    assert rows["fixed_best"]["paper"] == ""  # which does not compare it


def test_every_analysis_stands_beside_what_the_paper_says_of_it(page: str, report: Any) -> None:
    """The one over three experiments has the human's published trials, and all five fixed positions."""
    found = report["analyses_of_variance"]
    assert len(found) == 3
    for name, one in found.items():
        assert one["paper"].split(";")[0].replace("<", "&lt;") in page
        assert name in page
    three = next(one for name, one in found.items() if name.startswith("human, fixed"))
    groups = {t[side] for t in three["bonferroni"]["experiment"] for side in ("first", "second")}
    assert groups == {"human", "fixed", "human strategy"}
    trials = 90 + 6 * 18  # the human's, and six for each of three depths and six policies
    assert three["as_in_the_paper"]["residual_df"] == trials - 9


@pytest.mark.parametrize(("more", "sure"), [((1,), True), ((0,), False), ((-1,), False), ((2, -1), False)])
def test_that_deeper_takes_more_iterations_has_an_interval_over_sessions(
    more: tuple[int, ...], sure: bool
) -> None:
    sessions = [took_iterations(6, more[seed % len(more)], seed) for seed in range(6)]
    found = iterations(sessions, (0.002, 0.004, 0.008))
    assert list(found["by_depth"]) == ["2", "4", "8"]
    assert found["deepest_minus_shallowest"]["value"] == pytest.approx(2.0 * np.mean(more))
    assert (found["deepest_minus_shallowest"]["ci"][0] > 0.0) is sure
    assert found["within_5"] == pytest.approx(np.mean([6 + m * d <= 5 for m in more for d in range(3)]))


def took_iterations(shallow: int, more: int, seed: int) -> Outcomes:
    """Return a session whose trials took so many iterations, ``more`` for each next depth."""
    depth = np.random.default_rng(seed).permutation(np.repeat(np.arange(3), 4))
    flat, yes = np.ones((depth.size, 1)), np.ones(depth.size, dtype=bool)
    probes = shallow + more * depth
    return Outcomes(depth, depth, flat[:, 0], probes, flat[:, 0], yes, flat, yes[:, None])


def test_errors_that_stay_cost_accuracy_and_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"control": (), "only H1": ("H1",), "all": tuple(cases.HYPOTHESES)}
    monkeypatch.setattr(cases, "why_cells", lambda: few)
    rows = why_report(3, 10, Runner())["cells"]
    assert [row["cell"] for row in rows] == list(few)
    assert rows[0]["accuracy"] > rows[1]["accuracy"] > rows[2]["accuracy"]
    for row in rows:
        assert row["ci"][0] <= row["accuracy"] <= row["ci"][1]
        assert row["progress_ci"][0] <= row["progress"] <= row["progress_ci"][1]


@pytest.mark.slow
def test_the_scenes_are_judged_at_equal_seconds(tmp_path: Path) -> None:
    scenes = json.loads((run_few(tmp_path, 2) / "paper.json").read_text(encoding="utf-8"))["scenes"]
    assert set(scenes) == {"easy", "noisy", "unknown_height", "noisy_re_homed"}
    for one in scenes.values():
        enough_s = one["information_gain_latent"]["seconds"]
        assert one["best_fixed"]["seconds"] >= min(enough_s, 100.0) - 1e-6
        for line, value in ((one["best_fixed"], "accuracy"), (one, "difference")):
            low, high = line["ci" if value == "accuracy" else "difference_ci"]
            assert low <= line[value] <= high


def few_results(runner: Runner) -> bytes:
    plan = WorldPlan(gel=Gel(), conditions=Conditions(trials=4))
    return msgspec.json.encode(results(paper_sessions(plan, 3, runner), Gel().depths_m))


@pytest.mark.slow
def test_workers_do_not_change_the_results() -> None:
    assert few_results(Runner(workers=1)) == few_results(Runner(workers=2))


@pytest.mark.nightly
def test_a_dask_cluster_gives_the_same_json() -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        there = few_results(Runner(dask=cluster.scheduler_address))
    assert there == few_results(Runner())


@pytest.mark.parametrize(
    ("runner", "words"),
    [
        (Runner(dask="tcp://127.0.0.1:1"), re.escape(install_line("dask"))),
        (Runner(workers=0), "at least one process"),
    ],
)
def test_where_jobs_cannot_run_the_error_says_what_to_do(
    runner: Runner, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(PalpError, match=words):
        runner.run_jobs(len, ["job"], label="jobs")


@pytest.mark.parametrize(("share", "correlation"), [(0.6, 0.02), (0.8, 0.1), (0.7, 0.3)])
def test_the_correlation_of_simulated_sessions_is_found_again(share: float, correlation: float) -> None:
    rng, size = np.random.default_rng(0), 1.0 / correlation - 1.0
    right = rng.binomial(30, rng.beta(share * size, (1.0 - share) * size, 4000)) / 30
    assert correlate_trials(right, 30) == pytest.approx(correlation, abs=0.01 + 0.05 * correlation)
    assert correlate_trials(np.ones(5), 30) == 0.0


def test_simulated_experiments_have_the_power_that_their_sessions_are_counted_for() -> None:
    rng = np.random.default_rng(2)
    both = np.clip(0.7 + 0.05 * rng.standard_normal((2, 300, 3)), 0.0, 1.0)
    first, second = both[0] + 0.08, both[1]
    count, more = (count_sessions(first, second, trials, 0.8) for trials in (10, 3))
    assert count is not None
    which = rng.integers(0, 300, (1500, count))
    apart = (rng.binomial(10, first[which]) - rng.binomial(10, second[which])).mean(axis=-1) / 10
    assert np.mean(stats.ttest_1samp(apart, 0.0, axis=-1).pvalue < 0.05) == pytest.approx(0.83, abs=0.05)
    assert count_sessions(second, second, 10, 0.8) is None
    assert more is not None
    assert more > count
