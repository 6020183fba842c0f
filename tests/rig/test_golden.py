"""Every node of the rig says the same again: a change of an output shows as its first difference.

Where the change is meant, ``tests/golden/renew.py --reason ...`` records the runs again.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml

from msgs.estimation import Palpation
from msgs.stage import SweepStatus
from nodes.experiment import Experiment
from palp_core.graph.bag.diff import diff_bags
from palp_core.graph.bag.edit import copy_messages
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.rounds import NODES_ATTACHMENT
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.replay.replay import replay
from tests.golden import renew
from tests.golden.renew import GOLDEN, HERE, RELATIVE, RENEWED, SIM, TOLERANCE, close
from tests.support.rig_session import ComposedGraph, check_here

ROOT = SIM.parents[1]
NODES = [(node, name) for name, golden in GOLDEN.items() for node in golden.nodes]
WHY = yaml.safe_load((HERE / RENEWED).read_text(encoding="utf-8"))


@pytest.mark.parametrize(("node", "name"), NODES, ids=[node for node, _ in NODES])
def test_the_node_says_the_same_again(
    node: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = HERE / f"{name}.mcap"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Experiment, "records", False)  # it may keep its record: the folder is this test's
    (done,) = replay(bag, [node], ROOT, close)
    if (first := done.divergence) is not None:
        pytest.fail(
            f"{node} differs from {bag.name} (recorded because: {WHY[name]['reason']}) "
            f"first on {first.topic} {first.sequence} at {first.now_s:.6f} s, after {first.after}: "
            f"{first.what}; {done.compared} outputs were equal before. "
            f"If that is meant, see what else differs: python tests/golden/renew.py {name}"
        )
    assert done.compared > 0
    assert done.consumed > 0


def test_every_node_of_the_rig_has_a_golden_run() -> None:
    assert {spec.name for spec in check_here(SIM).nodes} == {node for node, _ in NODES}


def test_a_bag_as_the_source_of_the_rigs_graph_gives_the_recorded_outputs(tmp_path: Path) -> None:
    with ComposedGraph(str(ROOT / "launch" / "replay.yaml"), record=tmp_path / "again") as graph:
        graph.run()
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


def recorded(folder: Path, **changed: object) -> Path:
    """Write the golden sweep once more, with other values in the second status of the stage."""
    with Bag(HERE / "sweep.mcap") as bag, BagWriter(folder / "again") as writer:
        writer.attach(NODES_ATTACHMENT, bag.attachments()[NODES_ATTACHMENT], "application/json")
        for message in bag.recorded():
            if message.stream.topic.name == "/stage/status" and message.sequence == 2:
                status = msgspec.structs.replace(decode(SweepStatus, message.payload), **changed)
                message = message._replace(payload=encode(status))
            copy_messages([message], writer)
    return next((folder / "again").glob("*.mcap"))


@pytest.mark.parametrize("status", ["swept", "stuck"])
@pytest.mark.parametrize("words", [[], ["--reason", "it sticks"]], ids=["no-reason", "reason"])
def test_a_golden_run_is_renewed_where_it_differs_and_with_a_reason_only(
    status: str,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("PYTHONHASHSEED", "0")
    old = {name: (HERE / name).read_bytes() for name in ("sweep.mcap", RENEWED)}
    for name, content in old.items():
        (tmp_path / name).write_bytes(content)
    differs, why = status == "stuck", WHY
    refused = pytest.raises(SystemExit, match="sweep: not renewed; if that is meant, say why")
    with refused if differs and not words else contextlib.nullcontext():
        renew.main(["sweep", *words], tmp_path, lambda _, folder: recorded(folder, status=status))
    line = "/stage/status: message 1 (epoch 0, sequence 2): status: swept != stuck"
    assert capsys.readouterr().out == f"sweep:\n  {line if differs else 'equal'}\n"
    if differs and words:
        why = WHY | {"sweep": {"reason": "it sticks", "differences": [line]}}
        with Bag(tmp_path / "sweep.mcap") as bag:
            _, last = bag.recorded(["/stage/status"])
        assert decode(SweepStatus, last.payload).status == status
    else:
        assert {name: (tmp_path / name).read_bytes() for name in old} == old
    assert yaml.safe_load((tmp_path / RENEWED).read_text(encoding="utf-8")) == why
