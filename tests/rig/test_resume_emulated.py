"""A session on real drivers and emulated wires is killed, goes on, and has every trial once."""

from __future__ import annotations

import json
import os
from collections import Counter
from pathlib import Path

import pytest

from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from tests.graph.launch.killed import launch_and_kill, launch_to_its_end
from tests.rig.test_emulated import EMULATED, LENIENT
from tests.support.palp import Palp

HOST = f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.11"
SHORT = (
    *(
        "trials:=1",
        "training:=1",
        "rings_mm:=8, 16",
        "policy:=fixed",
        "shared.rehome:=never",
        "shared.max_probes:=2",
    ),
    *("shared.from_m:=-0.012", "shared.to_m:=0.012", "shared.lift_mm:=5.0", f"host:={HOST}", *LENIENT),
)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("topic", "count"), [*(("/experiment/progress", n) for n in (1, 6, 8)), ("", 4)], ids=str
)
def test_no_trial_is_lost_or_there_twice(topic: str, count: int, palp: Palp, tmp_path: Path) -> None:
    """Killed as so many palpations are written, or so many checkpoints."""
    out = tmp_path / "out"
    words = (*SHORT, f"out:={out}")
    launch_and_kill(palp, EMULATED, topic, count, *words)
    before = read_rows(out)
    launch_to_its_end(palp, EMULATED, *words)
    rows = read_rows(out)
    training = [row for row in rows if row.phase == "training"]
    assert [row.row for row in rows] == list(range(len(rows)))
    assert Counter((row.phantom, row.ring_m) for row in training) == {
        (code, ring_m): 1 for code in "ABC" for ring_m in (0.008, 0.016)
    }
    assert [row.trial for row in training] == [1, 2, 3, 4, 5, 6]
    ended = Counter(row.trial for row in rows if row.verdict not in ("", "continue"))
    assert ended == {1: 1, 2: 1, 3: 1}
    assert all(len(read_sweep(out, row.row)[0]) for row in rows)
    assert [row.start_ns for row in rows] == sorted(row.start_ns for row in rows)
    assert set(json.loads((out / "primitives.json").read_text())["count"][0]) == {1}
    cut = read_rows(out / "interrupted" / "1") if (out / "interrupted").exists() else []
    assert [row for row in before if row not in cut] == rows[: len(before) - len(cut)]
    assert len({row.trial for row in cut}) <= 1
    assert json.loads((out / "result.json").read_text())["trials_done"] == 3
    assert not (out / "checkpoint").exists()
