"""Codec, delivery and length of blocks: declared whole, and each chain of survivors comes to an end."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.methods import find, methods, task
from palp_core.methods.measured import measure_of, measured_tasks

ROOT = Path(__file__).resolve().parents[2]
TASKS = ("block", "codec", "delivery")


@pytest.mark.parametrize("name", TASKS)
def test_each_method_is_stated_with_evidence_that_is_there_and_says_where_it_fails(name: str) -> None:
    wanted = task(name)
    declared = methods(name)
    assert len(declared) > 3
    for one in declared:
        assert any(bound.output == wanted.output for bound in one.bounds), one.name
        assert (ROOT / one.evidence).is_file(), one.evidence
        assert one.valid, one.name
        assert one.fails, one.name
        seen = [one.name]
        while survivor := find(name, seen[-1]).survivor:
            assert survivor not in seen, seen
            seen.append(survivor)


@pytest.mark.parametrize("name", TASKS)
def test_each_task_can_be_measured(name: str) -> None:
    assert name in measured_tasks()
    assert measure_of(name)
