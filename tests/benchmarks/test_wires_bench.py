"""The bench of the wires measures what it says, with real nodes, and finds a limit that is there."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.launch.checking import check_file
from tests.support.palp import PATIENCE_S, ROOT

BENCH = ROOT / "benchmarks"
KINDS = ("trip", "call", "1mib", "rate", "fan")


def _module(name: str) -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH)
        return importlib.import_module(f"wire_bench.{name}")


@pytest.fixture(scope="module")
def plan() -> ModuleType:
    return _module("plan")


@pytest.fixture(scope="module")
def figures() -> ModuleType:
    return _module("figures")


def _bench(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(BENCH / "wires.py"), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src"), "COLUMNS": "160"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def test_the_bench_states_palp_over_raw_with_the_spread_of_its_rounds() -> None:
    done = _bench("--quick", "--only", "latency", "--rounds", 1, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for figure in ("p50_s", "p99_s", "cpu_s"):
        by_contender = found["measures"]["latency"][figure]
        assert set(by_contender) == {"palp", "raw"}
        assert all(row["value"]["least"] > 0.0 for row in by_contender.values())
        assert by_contender["raw"]["palp_over_it"]["median"] > 0.0
    assert found["lost"] == {"palp": 0, "raw": 0}


@pytest.mark.nightly
def test_a_call_is_stated_next_to_a_round_trip() -> None:
    done = _bench("--quick", "--rounds", 1, *(word for kind in KINDS for word in ("--only", kind)))
    assert done.returncode == 0, done.stderr
    for line in ("palp's own trip", "1mib rate", "rate rate", "call cpu", "fan p50"):
        assert line in done.stdout


@pytest.mark.nightly
@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ("rclpy", "sensor_msgs"))),
    reason="needs rclpy and sensor_msgs: pip install --editable '.[dev,ros2]'",
)
def test_ros2_is_measured_where_it_is_installed() -> None:
    done = _bench("--quick", "--rounds", 1, "--json", "--only", "latency", "--peer", "ros2")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["measures"]["latency"]["p50_s"]["ros2"]["palp_over_it"]["median"] > 0.0
    assert found["lost"]["ros2"] == 0


def test_a_peer_whose_end_fails_is_an_error_with_its_output(tmp_path: Path) -> None:
    script = tmp_path / "broken.py"
    script.write_text(
        "import sys, threading\n"
        "if sys.argv[1] == 'catcher': sys.exit('this end has no wire')\n"
        "threading.Event().wait()\n",
        encoding="utf-8",
    )
    phase = _module("plan").Phase("stream", 48, 1000.0, 0.1)
    with pytest.raises(RuntimeError, match=r"broken catcher0 ended with 1: this end has no wire"):
        _module("contenders").run_scripts(script, [phase])


def test_cpu_time_is_that_of_all_ends_between_begin_and_end(tmp_path: Path) -> None:
    burn = "d = time.process_time_ns() + 30_000_000\nwhile time.process_time_ns() < d: pass\n"
    child = (
        f"import sys, time\nfrom pathlib import Path\nsys.path.insert(0, {str(BENCH / 'wire_bench')!r})\n"
        f"from meter import sign_in\nsign_in(Path({str(tmp_path)!r}))\nprint(flush=True)\ninput()\n{burn}"
        "print(flush=True)\ninput()\n"
    )
    meter = _module("meter").Meter(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", child], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdin is not None
        assert other.stdout is not None
        other.stdout.readline()
        meter.begin()
        other.stdin.write("\n")
        other.stdin.flush()
        other.stdout.readline()
        meter.end(3)
        other.stdin.write("\n")
        other.stdin.flush()
    meter.write()
    ((phase, used_s),) = np.load(tmp_path / "cpu.npy")
    assert phase == 3
    assert used_s >= 0.03


def _results(figures: ModuleType, plan: ModuleType) -> Any:
    """Return three rounds of palp and raw pyzmq: p50 of 10, 30, 20 and 10, 20, 40 us."""
    results, outcome = figures.Results(), _module("contenders").Outcome
    measure = figures.Measure("latency", plan.Phase("stream", 48, 1000.0, 1.0))
    for name, p50s_us in (("palp", (10.0, 30.0, 20.0)), ("raw", (10.0, 20.0, 40.0))):
        for p50_us in p50s_us:
            times = {0: np.full(5, p50_us * 1e-6)}
            results.add(name, [measure], outcome(times, {}, {}, {0: 2e-6 * p50_us}, 0))
    return results


def test_a_ratio_is_of_one_round_and_stated_with_its_spread(figures: ModuleType, plan: ModuleType) -> None:
    results = _results(figures, plan)
    stated = results.summary()["measures"]["latency"]["p50_s"]
    assert list(stated["raw"]["palp_over_it"].values()) == pytest.approx([1.0, 0.5, 1.5])
    assert list(stated["palp"]["value"].values()) == pytest.approx([20e-6, 10e-6, 30e-6])
    (line,) = [
        line for line in results.table().splitlines() if line.startswith("latency p50 ") and "raw" in line
    ]
    assert " ".join(line.split()) == "latency p50 raw 20 us (10 to 40) 1.00 (0.50 to 1.50)"


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


def test_the_reader_counts_each_stage_and_keeps_only_streams(plan: ModuleType, tmp_path: Path) -> None:
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
