"""How many samples travel together is no part of what a session comes to."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.messages.frame import parse
from tests.rig.test_resume import SMALL
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph, RigSession

RESULTS = ("trials.csv", "primitives.json")


@pytest.mark.parametrize(
    "samples",
    [pytest.param(n, marks=[] if n == 500 else [pytest.mark.nightly]) for n in (50, 100, 250, 350, 500)],
)
def test_what_comes_out_has_the_same_bytes(samples: int, rig_session: RigSession, tmp_path: Path) -> None:
    """Times too: the end of a sweep is told at the same instant, however long blocks are."""
    out, counts = tmp_path / "out", {b"/torque/block": 0, b"/stage/status": 0}

    def observe(_: int, frame: bytes) -> None:
        topic = parse(frame).topic.encode()
        counts[topic] = counts.get(topic, 0) + 1

    overrides = [*SMALL, f"out:={out}", f"block_samples:={samples}"]
    with ComposedGraph(SIM, observe=observe, overrides=overrides) as graph:
        assert graph.run().exit_code == 0
    for name in RESULTS:
        assert (out / name).read_bytes() == (rig_session.out / name).read_bytes(), name
    ours, theirs = (sorted((folder / "sweeps").iterdir()) for folder in (out, rig_session.out))
    assert [one.name for one in ours] == [one.name for one in theirs]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(ours, theirs, strict=True))
    assert counts[b"/torque/block"] > 8 * len(ours)  # the session's has five a sweep
