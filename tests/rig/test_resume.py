"""A session on the machine's clock is killed, goes on, and has every trial once."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.bag.reader import Bag
from palp_core.palpation.session.human.record import read_human
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from tests.graph.launch.killed import launch_and_kill, launch_to_its_end
from tests.rig.test_emulated import EMULATED, LENIENT
from tests.rig.test_human import HUMAN, session
from tests.support.kept import require_each_row_once
from tests.support.palp import Palp

pytestmark = pytest.mark.nightly
HOST = f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.11"
SHORT = (
    *("trials:=1", "training:=1", "rings_mm:=8, 16", "policy:=fixed", "shared.rehome:=never"),
    *("shared.max_probes:=2", "shared.from_m:=-0.012", "shared.to_m:=0.012", "shared.lift_mm:=5.0"),
    *(f"host:={HOST}", *LENIENT),
)


def killed_and_resumed(
    palp: Palp, file: Path, kill: tuple[str, int], words: list[str], read: Callable[[Path], list[Any]]
) -> tuple[Path, list[Any]]:
    """Kill a run at so many messages of a topic, or checkpoints, and go on; return its folder and rows."""
    out = Path(words[-1].removeprefix("out:="))
    launch_and_kill(palp, file, *kill, *words)
    before = read(out)
    launch_to_its_end(palp, file, *words)
    require_each_row_once(out, before, read)
    assert not (out / "checkpoint").exists()
    return out, read(out)


@pytest.mark.parametrize("kill", [*(("/experiment/progress", n) for n in (1, 6, 8)), ("", 4)], ids=str)
def test_no_trial_on_emulated_wires_is_lost_or_there_twice(
    kill: tuple[str, int], palp: Palp, tmp_path: Path
) -> None:
    words = [*SHORT, f"out:={tmp_path / 'out'}"]
    out, rows = killed_and_resumed(palp, EMULATED, kill, words, read_rows)
    training = [row for row in rows if row.phase == "training"]
    assert Counter((row.phantom, row.ring_m) for row in training) == {
        (code, ring_m): 1 for code in "ABC" for ring_m in (0.008, 0.016)
    }
    assert [row.trial for row in training] == [1, 2, 3, 4, 5, 6]
    ended = Counter(row.trial for row in rows if row.verdict not in ("", "continue"))
    assert ended == {1: 1, 2: 1, 3: 1}
    assert all(len(read_sweep(out, row.row)[0]) for row in rows)
    assert [row.start_ns for row in rows] == sorted(row.start_ns for row in rows)
    assert set(json.loads((out / "primitives.json").read_text())["count"][0]) == {1}
    assert json.loads((out / "result.json").read_text())["trials_done"] == 3


@pytest.mark.parametrize("kill", [("", 1), ("/session/progress", 3), ("", 5)], ids=str)
def test_no_trial_of_a_person_is_lost_or_there_twice(
    kill: tuple[str, int], palp: Palp, tmp_path: Path
) -> None:
    """A recording stands for the person."""
    small = {"order": "counterbalanced", "repeats": 1, "palpation_s": 1.0}
    bag = session(tmp_path / "earlier", 1, **small) / "bag"
    words = [f"{name}:={value}" for name, value in small.items()]
    words += ["emg:=file", f"recording:={bag}", "operator:=script", "subject:=S01", "consent:=C-1"]
    words += ["rest_s:=0.0", "mvc_s:=2.0", f"out:={tmp_path / 'out'}"]
    out, rows = killed_and_resumed(palp, HUMAN, kill, words, read_human)
    assert [(row.phase, row.trial) for row in rows] == [
        (phase, trial) for phase in ("training", "estimation") for trial in (1, 2, 3)
    ]
    assert all((out / row.emg).exists() for row in rows)
    with Bag(out / "bag_2") as later:
        assert later.topics()
