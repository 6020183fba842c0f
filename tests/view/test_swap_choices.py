"""Which classes of a workspace may take a node's place: read from its files, which are not run."""

from __future__ import annotations

from pathlib import Path

import pytest

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


def test_where_nobody_reads_it_need_not_speak(workspace: Path) -> None:
    assert "nodes.ring:Mute" in fitting(workspace, "nodes.ring:Quick", set(), {"goal"})


def test_the_rig_s_policies_fit_each_other() -> None:
    root = Path(__file__).resolve().parents[2]
    found = fitting(root, "nodes.policy_fixed:Fixed", {"command"}, {"trial", "belief"})
    assert {"nodes.policy_markov:Markov", "nodes.policy_uniform:Uniform"} <= set(found)
    assert all(run.startswith("nodes.policy_") for run in found)
