"""Which classes of a workspace may take a node's place: read from its files, which are not run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("nicegui")

from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.view.pages.swap import choices
from palp_core.view.source.overview import Overview, WireState
from palp_core.view.source.swap_choices import fitting

NODES = """
import os
raise SystemExit("a file that is read is not run")

class Ring(Node):
    goal = Sub(Goal)
    extra = Sub(Extra, optional=True)
    place = Pub(Place)

class Quick(Ring):
    pass

class Careful(Node):
    goal: Sub[Goal] = ports.Sub(msgs.Goal)
    place = Pub(Place, qos=LATCHED)
    more = Pub(More)

class Mute(Node):
    goal = Sub(Goal)

class Wants(Node):
    goal = Sub(Goal)
    tide = Sub(Tide)
    place = Pub(Place)

class Other(Node):
    goal = Sub(Text)
    place = Pub(Place)

class Params:
    speed: float = 1.0
"""


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    (tmp_path / "nodes").mkdir()
    (tmp_path / "nodes/ring.py").write_text(NODES, encoding="utf-8")
    (tmp_path / "nodes/half.py").write_text("class Half(", encoding="utf-8")
    (tmp_path / "nodes/bytes.py").write_bytes(b"\xff\xfe\x00")
    return tmp_path


def test_what_has_the_outputs_that_are_read_and_no_open_input_fits(workspace: Path) -> None:
    assert fitting(workspace, "nodes.ring:Ring", {"place"}, {"goal"}) == [
        "nodes.ring:Quick",
        "nodes.ring:Careful",
    ]
    assert "nodes.ring:Mute" in fitting(workspace, "nodes.ring:Quick", set(), {"goal"})


def test_what_lies_under_a_workspace_fits_too_and_is_what_its_own_derive_from(workspace: Path) -> None:
    mine = workspace / "mine/nodes"
    mine.mkdir(parents=True)
    (mine / "mine.py").write_text(
        "from nodes.ring import Careful\n\nclass Mine(Careful):\n    pass\n", encoding="utf-8"
    )
    found = fitting(workspace / "mine", "nodes.ring:Ring", {"place"}, {"goal"}, [workspace])
    assert found == ["nodes.mine:Mine", "nodes.ring:Quick", "nodes.ring:Careful"]
    (mine / "ring.py").write_text("", encoding="utf-8")  # in place of that of the same name
    assert fitting(workspace / "mine", "nodes.ring:Ring", {"place"}, {"goal"}, [workspace]) == []


def test_a_policy_of_ones_own_and_those_of_the_installed_rig_are_offered(tmp_path: Path) -> None:
    (tmp_path / "nodes").mkdir()
    (tmp_path / "nodes/policy_mine.py").write_text(
        "from nodes.policy import PolicyNode\n\nclass Mine(PolicyNode):\n    pass\n", encoding="utf-8"
    )
    record = RunRecord(
        "rig", "rig:sim.yaml", "sim", 1, 0, "", [NodeEntry("policy", "nodes.policy_fixed:Fixed", 1, "", "")],
        [], workspace=str(tmp_path),
    )  # fmt: skip
    ports = [("trial", "estimator"), ("belief", "estimator")]
    inputs = {f"/{source}/{port}": {"port": port} for port, source in ports}
    wire = WireState(topic="/policy/command", source="policy", reader="ring")
    live = SimpleNamespace(
        graph=SimpleNamespace(
            record=record, ask=lambda *_, **__: {"run": "nodes.policy_fixed:Fixed", "inputs": inputs}
        ),
        overview=lambda: Overview(kind="graph", title="rig", wires=[wire]),
    )
    found = choices(live, "policy")  # type: ignore[arg-type]
    assert {"nodes.policy_mine:Mine", "nodes.policy_markov:Markov"} <= set(found)
    assert "nodes.policy:PolicyNode" not in found
