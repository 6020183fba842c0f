"""Every node of the rig says again what it said: a change of an output shows as its first difference.

Where the change is meant, ``tests/golden/renew.py --reason ...`` records the runs anew.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from msgs.estimation import Palpation
from nodes.experiment import Experiment
from palp_core.graph.bag.diff import diff_bags
from palp_core.graph.bag.reader import Bag
from palp_core.graph.replay.replay import replay
from tests.golden.renew import GOLDEN, HERE, REASON, SIM
from tests.support.palp import Palp, palp
from tests.support.rig_session import check_here

__all__ = ["palp"]

ROOT = SIM.parents[1]
NODES = [(node, name) for name, golden in GOLDEN.items() for node in golden.nodes]

RELATIVE, TOLERANCE = 1e-9, 1e-12
"""What another processor may change, whose vector instructions round otherwise: parts, and SI units."""


def close(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=TOLERANCE)


@pytest.mark.parametrize(("node", "name"), NODES, ids=[node for node, _ in NODES])
def test_the_node_says_what_it_said(
    node: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = HERE / f"{name}.mcap"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Experiment, "records", False)  # it may keep its record: the folder is this test's
    (done,) = replay(bag, [node], ROOT, close)
    with Bag(bag) as opened:
        reason = opened.metadata()[REASON]["reason"]
    if (first := done.divergence) is not None:
        pytest.fail(
            f"{node} differs from {bag.name} (recorded because: {reason}) first on {first.topic} "
            f"{first.sequence} at {first.now_s:.6f} s, after {first.after}: {first.what}; "
            f"{done.compared} outputs were equal before. "
            f'If that is meant: python tests/golden/renew.py --reason "why" {name}'
        )
    assert done.compared > 0
    assert done.consumed > 0


def test_every_node_of_the_rig_has_a_golden_run() -> None:
    assert {spec.name for spec in check_here(SIM).nodes} == {node for node, _ in NODES}


def test_a_bag_as_the_source_of_the_rigs_graph_gives_the_recorded_outputs(palp: Palp, tmp_path: Path) -> None:
    done = palp.run("launch", ROOT / "launch" / "replay.yaml", "--record", tmp_path / "again", "--compose")
    assert done.returncode == 0, done.stderr
    topics = ["/estimator/palpation", "/estimator/primitives", "/estimator/belief", "/policy/command"]
    found_again = diff_bags(
        HERE / "session.mcap", tmp_path / "again", topics, tolerance=TOLERANCE, relative=RELATIVE
    )
    for topic, found in found_again.items():
        assert found.first is None, f"{topic}: {found.first.text()}"
        assert found.equal_count + found.close_count > 0


def test_a_changed_node_is_caught_at_its_first_different_output(monkeypatch: pytest.MonkeyPatch) -> None:
    def a_little_more(**fields: Any) -> Palpation:
        return Palpation(**{**fields, "peak_n_m": fields["peak_n_m"] * (1.0 + 1e-6)})

    monkeypatch.setattr("nodes.estimator.Palpation", a_little_more)
    (done,) = replay(HERE / "session.mcap", ["estimator"], ROOT, close)
    assert done.divergence is not None
    assert (done.divergence.topic, done.divergence.sequence) == ("/estimator/palpation", 1)
    assert done.divergence.what.startswith("peak_n_m: recorded")
