"""The bench of the wires measures what it says, with real nodes, and finds a limit that is there."""

from __future__ import annotations

import csv
import importlib
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
STATED = ("median", "least", "largest", "rounds")


def _module(name: str) -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH)
        return importlib.import_module(f"wire_bench.{name}")


@pytest.fixture(scope="module")
def plan() -> ModuleType:
    return _module("plan")


@pytest.fixture(scope="module")
def peers() -> ModuleType:
    return _module("peers")


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


def test_the_bench_prints_one_object_and_writes_its_rounds(tmp_path: Path) -> None:
    one = ("--quick", "--only", "latency", "--rounds", 1, "--without", "raw_timeout")
    done = _bench(*one, "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["p50_ratio"] > 0.0
    assert found["p99_ratio"] > 0.0
    assert found["cpu_ratio"] > 0.0
    assert found["lost"] == 0
    assert found["absolute"]["raw"]["latency"]["p50_s"] > 0.0
    assert found["absolute"]["palp"]["latency"]["cpu_s"] > 0.0
    assert set(found["contenders"]) == set(found["ratios"]) == {"raw"}
    assert found["ratios"]["raw"]["p50_ratio"]["rounds"] == 1
    assert {path.name for path in tmp_path.iterdir()} == {"wires.csv", "wires.json"}


@pytest.mark.nightly
def test_a_call_is_stated_beside_a_round_trip_and_the_forms_of_raw_beside_palp() -> None:
    kinds = [word for kind in ("trip", "call", "1mib") for word in ("--only", kind)]
    done = _bench("--quick", "--rounds", 1, *kinds, "--peer", "raw_three")
    assert done.returncode == 0, done.stderr
    for said in ("palp's own trip", "raw_timeout: ", "raw_three: ", "1mib rate", "call cpu"):
        assert said in done.stdout


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["zenoh", "ros2", "ezmsg", "iceoryx2"])
def test_an_outside_peer_that_is_installed_runs_beside_palp(peers: ModuleType, name: str) -> None:
    cache = Path.home() / ".cache" / "palp-peers"
    if not (cache / name / peers.INSTALLED).exists():
        pytest.skip(f"{name} is not installed; benchmarks/wires.py --peer {name} does")
    kinds = [word for kind in ("latency", "64k", "trip", "rate", "1mib", "fan") for word in ("--only", kind)]
    done = _bench("--quick", "--rounds", 1, "--json", *kinds, "--without", "raw_timeout", "--peer", name)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["left_out"] == {}
    assert found["versions"][name]
    assert found["ratios"][name]["p50_ratio"]["median"] > 0.0
    assert found["lost_by_contender"][name] == 0
    assert found["absolute"][name]["rate"]["rate_hz"] > 0.0
    assert found["absolute"][name]["fan"]["cpu_s"] > 0.0


def test_a_peer_that_cannot_be_installed_is_left_out_by_name_with_the_reason(
    peers: ModuleType, tmp_path: Path
) -> None:
    (tmp_path / "ros2").write_text("no folder can be made here", encoding="utf-8")
    said: list[str] = []
    found = peers.contenders(("raw", "ros2", "raw_timeout"), tmp_path, said.append)
    assert list(found.runners) == ["palp", "raw", "raw_timeout"]
    assert list(found.left_out) == ["ros2"]
    assert str(tmp_path / "ros2") in found.left_out["ros2"]
    assert said[-1].startswith("ros2 is left out: ")


def test_every_peer_is_a_script_that_is_there(peers: ModuleType) -> None:
    assert all((peers.HERE / peer.script).is_file() for peer in peers.PEERS.values())
    assert set(peers.DEFAULT) <= set(peers.PEERS)


def test_a_peers_version_is_what_was_installed(peers: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "ros2").mkdir()
    (tmp_path / "ros2" / peers.INSTALLED).write_text("numpy==2.0\nros-rclpy==9.1.2\n", encoding="utf-8")
    assert peers.versions(("palp", "raw", "ros2"), tmp_path) == {"ros2": "9.1.2"}


def test_a_peer_whose_end_fails_says_what_that_end_said(peers: ModuleType, tmp_path: Path) -> None:
    script = tmp_path / "broken.py"
    script.write_text(
        "import sys, threading\n"
        "if sys.argv[1] == 'catcher': sys.exit('this end has no wire')\n"
        "threading.Event().wait()\n",
        encoding="utf-8",
    )
    phase = _module("plan").Phase("stream", 48, 1000.0, 0.1)
    with pytest.raises(RuntimeError, match=r"broken catcher0 ended with 1: this end has no wire"):
        peers.run_scripts(script, [phase], python=sys.executable)


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


def test_what_is_stated_is_the_median_with_least_and_largest_of_the_rounds(
    figures: ModuleType, plan: ModuleType, tmp_path: Path
) -> None:
    results = _results(figures, plan)
    found = results.summary()
    stated = found["ratios"]["raw"]["p50_ratio"]
    assert [stated[key] for key in STATED] == pytest.approx([1.0, 0.5, 1.5, 3])
    assert found["p50_ratio"] == pytest.approx(1.0)
    assert found["spread"]["p50_ratio"] == pytest.approx([0.5, 1.5])
    for key, p50_s in (("absolute", 20e-6), ("absolute_least", 10e-6), ("absolute_largest", 30e-6)):
        assert found[key]["palp"]["latency"]["p50_s"] == pytest.approx(p50_s)
    assert found["absolute"]["raw"]["latency"]["cpu_s"] == pytest.approx(40e-6)
    figures.write_csv(results, tmp_path / "wires.csv")
    with (tmp_path / "wires.csv").open(encoding="utf-8", newline="") as file:
        named = [
            (row["contender"], row["figure"], row["round"], row["value"]) for row in csv.DictReader(file)
        ]
    rows = {tuple(name): float(value) for *name, value in named}
    assert [rows["palp/raw", "p50_ratio", key] for key in ("1", "2", "3")] == pytest.approx([1.0, 1.5, 0.5])
    for key in STATED:
        assert rows["palp/raw", "p50_ratio", key] == pytest.approx(stated[key])
    assert rows["palp", "p50_s", "median"] == pytest.approx(20e-6)


def test_a_contender_that_fails_on_the_way_is_forgotten(figures: ModuleType, plan: ModuleType) -> None:
    results = _results(figures, plan)
    results.drop("raw")
    found = results.summary()
    assert found["ratios"] == {}
    assert list(found["absolute"]) == ["palp"]


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
