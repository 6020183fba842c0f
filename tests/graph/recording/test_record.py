"""``palp launch --record``: sample 0 is in the bag, nothing is missing, and a crash costs a moment."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from palp_core.graph.bag.reader import read, to_numpy
from tests.support.palp import CHAIN, Palp, own_workspace, wait_for_line
from tests.support.rig_session import ComposedGraph


def test_a_recording_holds_every_message_from_the_first(palp: Palp, tmp_path: Path) -> None:
    done = palp.here("launch", CHAIN, "clock:=sim", "count:=50", "--record", tmp_path / "processes")
    assert done.returncode == 0, done.stderr
    assert "nothing missing" in done.stdout
    chain: dict[str, object] = {"clock": "sim", "count": 50}
    with own_workspace(), ComposedGraph(CHAIN, record=tmp_path / "composed", **chain) as graph:
        graph.run()
    assert graph.recorders.complete
    equal = palp.run("bag", "diff", tmp_path / "composed", tmp_path / "processes")
    assert equal.returncode == 0, equal.stdout
    indices = to_numpy(tmp_path / "composed", "/relay/amplified", "index")
    assert indices.tolist() == list(range(50))
    raw = np.stack([m.value.torque_n_m for m in read(tmp_path / "composed", ["/source/sample"])])
    amplified = np.stack([m.value.torque_n_m for m in read(tmp_path / "composed", ["/relay/amplified"])])
    assert np.array_equal(2.0 * raw, amplified)
    info = json.loads(palp.run("bag", "info", tmp_path / "composed", "--json").stdout)
    assert {"/source/sample", "/relay/amplified", "/relay/_order"} <= set(info["topics"])


def test_what_a_killed_launcher_had_recorded_can_be_recovered(palp: Palp, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    process = palp.start("launch", CHAIN, "clock:=sim", "count:=10000000", "--compose", "--record", bag)
    wait_for_line(process, "blocks: 1/")
    while sum(file.stat().st_size for file in bag.glob("*.mcap")) < 1_500_000:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.02)
    process.kill()
    process.wait()
    recovered = palp.run("bag", "recover", bag, "-o", tmp_path / "recovered")
    assert recovered.returncode == 0, recovered.stderr
    indices = to_numpy(tmp_path / "recovered", "/source/sample", "index")
    assert len(indices) > 1000
    assert indices.tolist() == list(range(len(indices)))


def test_an_existing_bag_is_never_written_over(palp: Palp, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "mine").write_text("kept")
    done = palp.here("launch", CHAIN, "clock:=sim", "count:=5", "--record", tmp_path / "bag")
    assert done.returncode == 2
    assert (tmp_path / "bag" / "mine").read_text() == "kept"
