"""The bench of the wires measures what it says, with real nodes, and finds a limit that is there."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.launch.graph import check_file
from tests.support.palp import PATIENCE_S, ROOT

BENCH = ROOT / "benchmarks"


@pytest.fixture(scope="module")
def plan() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH)
        return importlib.import_module("wire_bench.plan")


def _bench(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(BENCH / "wires.py"), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def test_the_bench_prints_one_object_and_writes_charts(tmp_path: Path) -> None:
    done = _bench("--quick", "--only", "latency", "--rounds", 1, "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["p50_ratio"] > 0.0
    assert found["p99_ratio"] > 0.0
    assert found["lost"] == 0
    assert found["absolute"]["raw"]["latency"]["p50_s"] > 0.0
    assert {path.name for path in tmp_path.iterdir()} == {"wires.png", "wires.csv", "wires.json"}


@pytest.mark.nightly
def test_the_steady_graph_loses_nothing(tmp_path: Path) -> None:
    done = _bench("--steady", 5, "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["sent"] == {"torque": 5000, "emg": 7500}
    assert found["lost"] == 0
    assert found["timers"]["torque"]["ticks"] >= 5000
    assert all(timer["late_p50_us"] >= 0.0 for timer in found["timers"].values())
    assert set(found["processes"]) >= {"launcher", "torque", "emg", "estimator", "policy"}
    assert (tmp_path / "jitter.png").exists()


@pytest.mark.parametrize("path", sorted((BENCH / "wire_bench/launch").glob("*.yaml")), ids=lambda p: p.stem)
def test_the_benchs_launch_files_pass_the_check(path: Path) -> None:
    assert check_file(path).nodes


@given(limit_hz=st.floats(100.0, 1e6))
@settings(deadline=None, max_examples=25)
def test_the_search_finds_the_highest_rate_that_is_kept(plan: ModuleType, limit_hz: float) -> None:
    search = plan.Search(plan.Phase("search", 48, 8000.0, 0.4))
    while not search.over:
        took_s = search.total / min(search.rate_hz, limit_hz)
        search.judge(search.total, round(took_s * 1e9))
    # a rate passes although it is a little too high, as long as the reader is not 10 ms behind at the end
    stage_s = search.total / search.best_hz
    assert limit_hz / 1.04 <= search.best_hz <= limit_hz * (1.0 + 0.0101 / stage_s)


def test_a_stage_with_a_message_missing_fails_even_if_it_was_fast(plan: ModuleType) -> None:
    search = plan.Search(plan.Phase("search", 48, 8000.0, 0.4))
    search.judge(search.total - 1, 0)
    search.judge(search.total - 1, 0)
    assert search.best_hz == 0.0
    assert search.rate_hz < 8000.0


def test_one_hiccup_is_not_a_limit(plan: ModuleType) -> None:
    search = plan.Search(plan.Phase("search", 48, 8000.0, 0.4))
    search.judge(0, 10**10)
    assert search.rate_hz == 8000.0
    search.judge(search.total, 0)
    assert search.best_hz == 8000.0


def test_the_reader_counts_each_stage_anew_and_keeps_only_streams(plan: ModuleType, tmp_path: Path) -> None:
    arrivals = plan.Arrivals()
    assert not arrivals.take(plan.index_of(0, 0, 1), 10, 20)
    assert arrivals.take(plan.index_of(1, 0, 1, asked=True), 30, 40)
    assert not arrivals.take(plan.index_of(2, 1, 1), 50, 60)
    assert arrivals.take(plan.index_of(2, 1, 2, asked=True), 50, 60)
    assert arrivals.count == 2
    arrivals.write(tmp_path / "rows.npy")
    assert len(arrivals.rows) == 2 * 3


def test_a_search_ends_when_nothing_arrives_any_more(plan: ModuleType) -> None:
    search = plan.Search(plan.Phase("search", 48, 8000.0, 0.4))
    search.judge(search.total, 0)
    for _ in range(3):
        assert not search.over
        search.judge(0, search.timeout_ns)
    assert search.over
    assert search.best_hz == 8000.0
