"""The study ``features``: errors, lags and costs of every way to a feature, on one chart."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.palpation.mechanics import Scene, run_scene
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.decision.feature_cases import clean_cases, measure, ways
from palp_core.palpation.studies.simulation.reading_table import RATE_HZ, TO_M
from palp_core.palpation.studies.toolkit.pareto import pareto_front


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study("features").run(tmp_path_factory.mktemp("features"), quick=True)


@pytest.mark.slow
def test_the_study_leaves_page_chart_table_and_numbers(
    page: Path, strict_json: Callable[[Path], Any]
) -> None:
    names = {path.name for path in page.parent.iterdir()}
    assert names == {"index.html", "features.png", "features.svg", "features.csv", "features.json"}
    record = strict_json(page.parent / "features.json")
    assert len(record["ways"]) == 2 * 2 * len(ways(quick=True))
    assert all(row["lag_s"] >= 0.0 for row in record["ways"])


@pytest.mark.slow
def test_smoothing_beats_none_and_a_late_stream_equals_offline(page: Path) -> None:
    rows = json.loads((page.parent / "features.json").read_text())["ways"]

    def of(family: str, setting: str) -> list[float]:
        return [r["rms_n_m"] for r in rows if (r["family"], r["setting"]) == (family, setting)]

    bare = of("none", "none")
    for row in rows:
        if row["family"] != "none":
            index = (row["noise_factor"] > 1.0) * 2 + (row["feature"] == "contrast")
            assert row["rms_n_m"] < bare[index]
    assert of("db10 approximation, stream", "589 ms") == pytest.approx(
        of("db10 approximation, offline", "sweep"), rel=1e-9
    )


def test_cases_have_the_truth_of_their_own_sweep() -> None:
    cases = clean_cases((0.016,))
    assert [case.depth_m for case in cases] == [0.002, 0.004, 0.008]
    scenes = [Scene(ring_m=(0.016,)).with_bead(case.depth_m) for case in cases]
    peaks = [run_scene(scene, "l2").peak_n_m[0] for scene in scenes]
    assert [case.truth_n_m["peak"] for case in cases] == pytest.approx(peaks, rel=1e-3)
    assert all(gap > 0.0 for case in cases for gap in case.gap_n_m.values())
    assert len(cases[0].torque_n_m) == round((TO_M + 0.03) / 0.02 * RATE_HZ)


def test_the_same_seed_gives_the_same_errors() -> None:
    cases, way = clean_cases((0.016,)), ways(quick=True)[1]
    first, again = (measure(way, cases, 1.0, 2, np.random.default_rng(4)) for _ in range(2))
    assert [r.rms_n_m for r in first] == [r.rms_n_m for r in again]


def test_the_front_is_what_nothing_beats_in_both() -> None:
    assert pareto_front([1.0, 2.0, 2.0, 3.0], [5.0, 4.0, 6.0, 4.5]) == [0, 1]
