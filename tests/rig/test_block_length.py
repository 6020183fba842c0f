"""How many samples travel together is no part of what a session comes to."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.messages.frame import parse
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph, RigSession

SMALL = ("trials:=2", "training:=2", "seed:=1", "policy:=markov")
RESULTS = ("trials.csv", "primitives.json")


@pytest.fixture(scope="module", params=["paper", pytest.param("lab", marks=pytest.mark.nightly)])
def usual(
    request: pytest.FixtureRequest, rig_session: RigSession, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """A world, and the record of a session in it with blocks as they are by default."""
    if request.param == "paper":
        return request.param, rig_session.out
    out = tmp_path_factory.mktemp("lab") / "out"
    with ComposedGraph(SIM, overrides=[*SMALL, f"out:={out}", "world:=lab"]) as graph:
        assert graph.run().exit_code == 0
    return request.param, out


@pytest.mark.parametrize(
    "samples",
    [pytest.param(n, marks=[] if n == 500 else [pytest.mark.nightly]) for n in (50, 100, 250, 350, 500)],
)
def test_what_comes_out_has_the_same_bytes(samples: int, usual: tuple[str, Path], tmp_path: Path) -> None:
    """Times too: the end of a sweep is told at the same instant, however long blocks are."""
    (world, expected), out = usual, tmp_path / "out"
    counts = {b"/torque/block": 0, b"/stage/status": 0}

    def observe(_: int, frame: bytes) -> None:
        topic = parse(frame).topic.encode()
        counts[topic] = counts.get(topic, 0) + 1

    overrides = [*SMALL, f"out:={out}", f"stage.block_samples:={samples}", f"world:={world}"]
    with ComposedGraph(SIM, observe=observe, overrides=overrides) as graph:
        assert graph.run().exit_code == 0
    for name in RESULTS:
        assert (out / name).read_bytes() == (expected / name).read_bytes(), name
    ours, theirs = (sorted((folder / "sweeps").iterdir()) for folder in (out, expected))
    assert [one.name for one in ours] == [one.name for one in theirs]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(ours, theirs, strict=True))
    assert counts[b"/torque/block"] > 8 * len(ours)  # the usual one has five a sweep
