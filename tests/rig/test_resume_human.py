"""A session with a person on the machine's clock is killed, goes on, and has every trial once."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.bag.reader import Bag
from palp_core.palpation.session.human.record import read_human
from tests.graph.launch.killed import launch_and_kill, launch_to_its_end
from tests.rig.test_human import HUMAN, session
from tests.support.palp import Palp


@pytest.mark.nightly
@pytest.mark.parametrize(("topic", "count"), [("", 1), ("/session/progress", 3), ("", 5)])
def test_no_trial_is_lost_or_there_twice(topic: str, count: int, palp: Palp, tmp_path: Path) -> None:
    """Killed after so many checkpoints or trials; a recording stands for the person."""
    small = {"order": "counterbalanced", "repeats": 1, "palpation_s": 1.0}
    bag = session(tmp_path / "earlier", 1, **small) / "bag"
    out = tmp_path / "out"
    words = [f"{name}:={value}" for name, value in small.items()]
    words += ["emg:=file", f"recording:={bag}", "operator:=script", "subject:=S01", "consent:=C-1"]
    words += ["rest_s:=0.0", "mvc_s:=2.0", f"out:={out}"]
    launch_and_kill(palp, HUMAN, topic, count, *words)
    before = read_human(out)
    launch_to_its_end(palp, HUMAN, *words)
    rows = read_human(out)
    assert [row.row for row in rows] == list(range(6))
    assert [(row.phase, row.trial) for row in rows] == [
        (phase, trial) for phase in ("training", "estimation") for trial in (1, 2, 3)
    ]
    cut = read_human(out / "interrupted" / "1") if (out / "interrupted").exists() else []
    assert [row for row in before if row not in cut] == rows[: len(before) - len(cut)]
    assert all((out / row.emg).exists() for row in rows)
    assert not (out / "checkpoint").exists()
    with Bag(out / "bag_2") as later:
        assert later.topics()
