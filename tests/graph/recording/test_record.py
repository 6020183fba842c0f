"""``palp launch --record``: sample 0 is in the bag, nothing is missing, and a crash costs a moment."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from palp_core.graph.bag.reader import read, to_numpy
from tests.support.palp import CHAIN, Palp, own_workspace
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
