import csv
import itertools
import json
import re
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.paper import study as paper_study
from palp_core.palpation.studies.paper.charts_human import figure_5
from palp_core.palpation.studies.paper.numbers import (
    HUMAN_2MM_RIGHT,
    HUMAN_OVER_TRIALS,
    HUMAN_RIGHT,
    statements,
)
from palp_core.palpation.studies.paper.study import PaperSize, paper_session, results
from palp_core.palpation.studies.paper.tests import iterations
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.palpation.studies.toolkit.parallel import Runner, run_jobs
from tests.support.drawing import render_nothing

NAMES = {
    "chance",
    "best_single_probe",
    *(f"fixed_{x}" for x in (0, 4, 8, 12, 16, "average", "best")),
    *(f"markov{x}" for x in ("", "_stationary", "_reversed", "_permuted")),
    *("uniform", "uniform_stiff", "information_gain", "information_gain_latent", "reposition_best"),
}


WHY = {
    "cell": "only H1", "accuracy": 0.8, "ci": [0.7, 0.9], "progress": 0.1, "progress_ci": [0.0, 0.2],
    "probes": 2.0, "ece": 0.1,
}  # fmt: skip


def run_few(folder: Path, scene_sessions: int) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        if not scene_sessions:
            render_nothing(patch)
        patch.setattr(paper_study, "QUICK", PaperSize(2, scene_sessions, 0, trials=6))
        patch.setattr(paper_study, "_why", lambda *_: {"hypotheses": {"H1": "one"}, "cells": [WHY]})
        page = study("paper").run(folder, quick=True)
    assert page == folder / "index.html"
    return folder


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_few(tmp_path_factory.mktemp("paper"), 0)


@pytest.fixture(scope="module")
def plan() -> WorldPlan:
    return WorldPlan(gel=Gel(), conditions=Conditions(trials=4))


def test_every_policy_is_reported_with_what_a_reader_needs(out: Path) -> None:
    report = json.loads((out / "paper.json").read_text(encoding="utf-8"))
    assert set(report["policies"]) == NAMES
    for line in report["policies"].values():
        assert {"accuracy", "ci", "per_depth", "probes", "seconds", "ece", "sessions"} <= set(line)
        low, high = line["ci"]
        assert 0.0 <= low <= line["accuracy"] <= high <= 1.0
        assert set(line["per_depth"]) == {"2", "4", "8"}
        assert line["sessions"] == 2


def test_every_figure_and_table_is_on_the_page(out: Path) -> None:
    page = (out / "index.html").read_text(encoding="utf-8")
    for number in ("3", "4", "5", "7(b)", "8", "9", "10", "11", "12"):
        assert f"Figure {number}" in page
    for said in (
        "Tables 3 and 4",
        "Table 5",
        "Table 6",
        "How many sessions a comparison takes",
        "Why would a fixed stiffness make no progress?",
        "published numbers",
        "reconstruction",
    ):
        assert said.lower() in page.lower()
    pictures = sorted(path.stem for path in out.glob("*.png"))
    assert len(pictures) >= 8
    assert {path.stem for path in out.glob("*.csv")} == set(pictures)
    assert all(f"{stem}.png" in page for stem in pictures)


def test_figure_12_has_the_best_fixed_position_beside_the_papers_bars(out: Path) -> None:
    with (out / "figure_12_comparison.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["experiment"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["human", "fixed_average", "fixed_best", "markov"]
    best = json.loads((out / "paper.json").read_text(encoding="utf-8"))["policies"]["fixed_best"]
    assert float(rows["fixed_best"]["ours"]) == best["accuracy"]
    assert rows["fixed_best"]["paper"] == ""  # which does not compare it


def test_every_analysis_stands_beside_what_the_paper_says_of_it(out: Path) -> None:
    """The one over three experiments has the human's published trials, and all five fixed positions."""
    report = json.loads((out / "paper.json").read_text(encoding="utf-8"))["analyses_of_variance"]
    page = (out / "index.html").read_text(encoding="utf-8")
    assert len(report) == 3
    for name, one in report.items():
        assert one["paper"].split(";")[0].replace("<", "&lt;") in page
        assert name in page
    three = next(one for name, one in report.items() if name.startswith("human, fixed"))
    groups = {t[side] for t in three["bonferroni"]["experiment"] for side in ("first", "second")}
    assert groups == {"human", "fixed", "human strategy"}
    assert "With 2 sessions no p among 11 comparisons can be below 1" in page
    trials = 90 + 6 * 18  # the human's, and six for each of three depths and six policies
    assert three["as_in_the_paper"]["residual_df"] == trials - 9


def test_the_iterations_of_the_human_strategy_are_under_figure_11(out: Path) -> None:
    report = json.loads((out / "paper.json").read_text(encoding="utf-8"))
    page = (out / "index.html").read_text(encoding="utf-8")
    took = report["iterations"]["by_depth"]
    assert set(took) == {"2", "4", "8"}
    mean = np.mean([one["value"] for one in took.values()])
    assert mean == pytest.approx(report["policies"]["markov"]["probes"])
    assert f"{took['8']['value']:.2f} at 8 mm" in page


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
    flat = np.ones((depth.size, 1))
    yes = np.ones(depth.size, dtype=bool)
    return Outcomes(
        depth, depth, flat[:, 0], shallow + more * depth, depth, flat[:, 0], yes, flat, yes[:, None]
    )


def test_the_counts_over_trials_are_those_of_six_subjects_and_of_the_whole() -> None:
    """The text's three numbers: 65 % then above 80 % at 2 mm, 65 % at 4 and 8 mm in the third trial."""
    assert sum(HUMAN_2MM_RIGHT) == HUMAN_RIGHT["2"]
    first, *others = (right / 6 for right in HUMAN_2MM_RIGHT)
    said = {(depth, trial): share for depth, trial, share in HUMAN_OVER_TRIALS}
    assert said == {(2, 1): 0.65, (2, 2): 0.80, (4, 3): 0.65, (8, 3): 0.65}
    assert abs(first - said[2, 1]) == min(abs(n / 6 - said[2, 1]) for n in range(7))
    assert all(share > said[2, 2] for share in others)
    of_six = itertools.product(range(5, 7), repeat=4)
    assert [one for one in of_six if 4 + sum(one) == HUMAN_RIGHT["2"]] == [HUMAN_2MM_RIGHT[1:]]


@pytest.mark.slow
def test_the_scenes_are_judged_at_equal_seconds(tmp_path: Path) -> None:
    scenes = json.loads((run_few(tmp_path, 2) / "paper.json").read_text(encoding="utf-8"))["scenes"]
    assert set(scenes) == {"easy", "noisy", "unknown_height", "noisy_re_homed"}
    for one in scenes.values():
        enough_s = one["information_gain_latent"]["seconds"]
        assert one["best_fixed"]["seconds"] >= min(enough_s, 100.0) - 1e-6
        low, high = one["difference_ci"]
        assert low <= one["difference"] <= high
        low, high = one["best_fixed"]["ci"]
        assert low <= one["best_fixed"]["accuracy"] <= high


def sessions(plan: WorldPlan, runner: Runner) -> list[dict[str, Outcomes]]:
    (found,) = runner.run(paper_session, [plan], 3, stream=0, label="sessions")
    return found


@pytest.mark.slow
def test_workers_do_not_change_the_results(plan: WorldPlan) -> None:
    here, there = (sessions(plan, Runner(workers=count)) for count in (1, 2))
    by_name = [{name: [one[name] for one in found] for name in found[0]} for found in (here, there)]
    assert results(by_name[0], Gel().depths_m) == results(by_name[1], Gel().depths_m)


@pytest.mark.nightly
def test_a_dask_cluster_gives_the_same_json(plan: WorldPlan) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        there = sessions(plan, Runner(dask=cluster.scheduler_address))
    here = sessions(plan, Runner())
    by_name = [{name: [one[name] for one in found] for name in found[0]} for found in (here, there)]
    texts = [msgspec.json.encode(results(found, Gel().depths_m)) for found in by_name]
    assert texts[0] == texts[1]


def test_without_dask_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(PalpError, match=re.escape(install_line("dask"))):
        run_jobs(len, ["job"], label="jobs", dask="tcp://127.0.0.1:1")


def test_no_worker_is_too_few() -> None:
    with pytest.raises(PalpError, match="at least one process"):
        run_jobs(len, ["job"], label="jobs", workers=0)


@pytest.mark.parametrize(
    ("name", "option", "value", "said"),
    [
        ("stability", "workers", 2, "'stability' does not take --workers; leave it out"),
        ("paper", "mounting", "each_trial", "'paper' does not take --mounting; leave it out"),
        ("frontier", "mounting", "grooped", "no mounting 'grooped'; use one of grouped, each_trial, block_"),
        ("frontier", "specimens", "others", "no specimens 'others'; use one of same, other"),
    ],
)
def test_a_study_refuses_an_option_that_it_cannot_use(
    name: str, option: str, value: object, said: str, tmp_path: Path
) -> None:
    with pytest.raises(PalpError, match=said):
        study(name).run(tmp_path, **{option: value})


def test_the_papers_counts_carry_its_statements_or_not() -> None:
    found = {(one.text, one.assumption): one for one in statements()}
    human = found["human: depth has no significant influence", ""]
    assert human.p == pytest.approx(0.093, abs=1e-3)
    same = found["human against fixed: no difference", "fixed 200 of 300 trials"]
    assert same.p == pytest.approx(0.70, abs=0.01)
    better = found["varied stiffness better than fixed", "fixed 200 of 300 trials, varied 271 of 300"]
    assert better.p == pytest.approx(1.187e-12, rel=1e-3, abs=0.0)  # Fisher, 271 of 300 against 200
    assert found["varied stiffness better than fixed", "fixed 10 of 15 cells, varied 271 of 300"].p < 0.05
    assert not found["fixed: depth has a significant influence", "fixed 10 of 15 cells"].holds
    assert found["fixed: depth has a significant influence", "fixed 200 of 300 trials"].holds


def test_the_matrices_have_a_scale_of_colours() -> None:
    drawn = Figure()
    figure_5().draw(drawn)
    (bar,) = (axes for axes in drawn.axes if axes.get_ylabel() == "probability")
    assert bar.get_ylim() == (0.0, 0.6)
