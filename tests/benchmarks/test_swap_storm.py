"""The storm of swaps finds every fault that is on the tapes, and excuses only what a kill destroyed."""

from __future__ import annotations

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

from palp_core.graph.launch.checking import check_file
from tests.support.palp import PATIENCE_S, ROOT

BENCH = ROOT / "benchmarks"
SOURCE, OLD, NEW, READER, NEXT_READER = range(1, 6)


@pytest.fixture(scope="module")
def tapes() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH)
        return importlib.import_module("swap_bench.storm_tapes")


def verdict(
    tapes: ModuleType,
    *got: tuple[int, int, int],
    sent: int = 6,
    killed: int = 0,
    handed_over: int = 0,
    passed: dict[int, int] | None = None,
    best_effort: bool = False,
) -> tuple[int, int, int, int]:
    """Judge one life of the source: each of ``got`` is index, who passed it on, and the reader's process."""
    makers = dict.fromkeys(range(1, sent + 1), OLD) if passed is None else passed
    found = tapes.Judge(best_effort=best_effort).judge(
        np.array([(7, index, SOURCE) for index in range(1, sent + 1)]),
        np.array([(7, index, maker) for index, maker in makers.items()]).reshape(-1, 3),
        np.array([(7, *row, 1_000_000 * at) for at, row in enumerate(got)]).reshape(-1, 5),
        tapes.Deaths(frozenset([killed]), frozenset([handed_over])),
    )
    return found.lost, found.repeated, found.reordered, found.explained


def row(*indices: int, by: int = OLD, reader: int = READER) -> list[tuple[int, int, int]]:
    return [(index, by, reader) for index in indices]


ALL = (1, 2, 3, 4, 5, 6)
SPLIT = dict.fromkeys((1, 2, 3), OLD) | dict.fromkeys((4, 5, 6), NEW)


def test_whatever_is_wrong_counts(tapes: ModuleType) -> None:
    assert verdict(tapes, *row(*ALL)) == (0, 0, 0, 0)
    assert verdict(tapes, *row(1, 2, 4, 5, 6)) == (1, 0, 0, 0)
    assert verdict(tapes, *row(1, 2, 2, 3, 4, 5, 6)) == (0, 1, 0, 0)
    assert verdict(tapes, *row(1, 3, 2, 4, 5, 6)) == (0, 0, 1, 0)


def test_only_the_last_that_a_killed_relay_had_is_excused(tapes: ModuleType) -> None:
    new = row(4, 5, 6, by=NEW)
    assert verdict(tapes, *row(1, 2), *new, passed=SPLIT, killed=OLD) == (0, 0, 0, 1)
    assert verdict(tapes, *row(1, 3), *new, passed=SPLIT, killed=OLD) == (1, 0, 0, 0)
    assert verdict(tapes, *row(1, 2), *new, passed=SPLIT, killed=NEW) == (1, 0, 0, 0)
    assert verdict(tapes, *row(1, 2), *new, passed=SPLIT, killed=OLD, handed_over=OLD) == (1, 0, 0, 0)


def test_what_no_relay_had_is_excused_by_the_sources_death_alone(tapes: ModuleType) -> None:
    passed = dict.fromkeys((1, 2, 3, 4), OLD)
    assert verdict(tapes, *row(1, 2, 3, 4), passed=passed, killed=SOURCE) == (0, 0, 0, 2)
    assert verdict(tapes, *row(1, 2, 3, 4), passed=passed, killed=OLD) == (2, 0, 0, 0)
    hole = dict.fromkeys((1, 2, 4, 5, 6), OLD)
    assert verdict(tapes, *row(1, 2, 4, 5, 6), passed=hole, killed=SOURCE) == (1, 0, 0, 0)


def test_a_killed_reader_may_take_one_up_again_and_miss_some_only_with_best_effort(tapes: ModuleType) -> None:
    back = row(3, 4, 5, 6, reader=NEXT_READER)
    assert verdict(tapes, *row(1, 2, 3), *back, killed=READER) == (0, 0, 0, 1)
    assert verdict(tapes, *row(1, 2, 3, 4), *back, killed=READER) == (0, 1, 0, 1)
    assert verdict(tapes, *row(1), *back, killed=READER) == (1, 0, 0, 0)
    assert verdict(tapes, *row(1), *back, killed=READER, best_effort=True) == (0, 0, 0, 1)
    assert verdict(tapes, *row(1), *back, killed=OLD, best_effort=True) == (1, 0, 0, 0)


def test_the_launch_file_passes_the_check(tmp_path: Path) -> None:
    assert check_file(BENCH / "swap_bench/launch/storm.yaml", [f"out:={tmp_path}"]).nodes


@pytest.mark.nightly
def test_swaps_under_faults_lose_repeat_and_reorder_nothing(tmp_path: Path) -> None:
    arguments = ("--storm", 22, "--seed", 1, "--busy", 2, "--json", "--out", tmp_path)
    done = subprocess.run(
        [sys.executable, str(BENCH / "swap.py"), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
        timeout=10 * PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    assert found["failures"] == []
    assert (found["by_fault"]["all"]["tries"], found["by_fault"]["none"]["swapped"]) == (22, 2)
    assert found["by_fault"]["all"]["swapped"] >= 11
