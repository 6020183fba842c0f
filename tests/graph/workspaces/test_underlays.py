"""Workspaces that packages bring: their launch files by name, their modules under one's own."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.errors import GraphError
from palp_core.graph.description.resolver import resolve
from palp_core.graph.node.loading import enter_workspace, load_class, source_of
from palp_core.graph.workspaces import underlays
from palp_core.graph.workspaces.modules import hidden_modules
from palp_core.graph.workspaces.underlays import launch_path
from tests.graph.workspaces.installed import forgetting, install
from tests.support.palp import ROOT

SHAPE = """
from palp_core import Node


class Shape(Node):
    '''Of {}.'''
"""
LAUNCH = "graph: shapes\nclock: sim\nnodes:\n  shape: {run: nodes.shape:Shape}\n"
SOFTLAB = {
    "softlab/__init__.py": "",
    "softlab/rig/__init__.py": "",
    "softlab/rig/nodes/__init__.py": "",
    "softlab/rig/nodes/shape.py": SHAPE.format("softlab"),
    "softlab/rig/nodes/round.py": "from nodes.shape import Shape\n",
    "softlab/rig/nodes/kinds/deep.py": "",
    "softlab/rig/msgs/__init__.py": "",
    "softlab/rig/launch/shapes.yaml": LAUNCH,
}


@pytest.fixture
def softlab(tmp_path: Path) -> Iterator[Path]:
    """Install a lab's package with a workspace; return the folder of the workspace."""
    site = tmp_path / "site"
    install(site, "softlab", SOFTLAB, {underlays.GROUP: {"softlab": "softlab.rig"}})
    with forgetting() as patch:
        patch.syspath_prepend(str(site))
        # the tests' own environment has the repository first, whose nodes would be found before any other's
        patch.setattr(sys, "path", [p for p in sys.path if not (Path(p or ".") / "nodes").is_dir()])
        yield site / "softlab/rig"


@pytest.fixture
def own(tmp_path: Path, softlab: Path) -> Path:
    """Return a workspace of one's own that has one node more, and enter it."""
    folder = tmp_path / "own"
    (folder / "nodes").mkdir(parents=True)
    (folder / "nodes/mine.py").write_text(SHAPE.format("mine"), encoding="utf-8")
    enter_workspace(str(folder))
    return folder


def test_palps_own_workspace_is_found_and_lies_under_everybody_elses(softlab: Path) -> None:
    assert [one.name for one in underlays.underlays()] == ["softlab", "rig"]
    assert underlays.underlay("softlab").folder == softlab
    assert underlays.underlay("rig").launch_files() == [
        "emulated.yaml", "human.yaml", "replay.yaml", "rig.yaml", "sim.yaml",
    ]  # fmt: skip


def test_a_launch_file_is_named_by_its_workspace(
    softlab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert launch_path("softlab:shapes.yaml") == softlab / "launch/shapes.yaml"
    assert resolve(Path("softlab:shapes.yaml")).workspace == softlab


def test_the_workspace_that_one_is_in_lies_over_an_installed_launch_file(
    own: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (own / "deeper").mkdir()
    monkeypatch.chdir(own / "deeper")
    assert resolve(Path("softlab:shapes.yaml")).workspace == own


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("softlab:shape.yaml", "did you mean 'softlab:shapes.yaml'? there are: shapes.yaml"),
        ("softlab:", "no launch file '' in .*; there are: shapes.yaml"),
        ("softlab:../nodes/shape.py", "there are: shapes.yaml"),
        ("softlob:shapes.yaml", "no installed workspace 'softlob'; did you mean 'softlab'?"),
    ],
)
def test_a_wrong_name_is_answered_with_what_there_is(softlab: Path, name: str, text: str) -> None:
    with pytest.raises(GraphError, match=text.replace("?", r"\?")):
        launch_path(name)


def test_a_file_of_ones_own_with_such_a_name_comes_first(softlab: Path, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        Path("softlab:shapes.yaml").write_text(LAUNCH, encoding="utf-8")
        assert launch_path("softlab:shapes.yaml") == Path("softlab:shapes.yaml")


def test_a_launch_file_includes_one_of_an_installed_workspace(own: Path) -> None:
    file = own / "more.yaml"
    text = "graph: more\nclock: sim\ninclude: [{file: softlab:shapes.yaml}]\n"
    text += "nodes: {mine: {run: nodes.mine:Shape}}\n"
    file.write_text(text, encoding="utf-8")
    description = resolve(file)
    assert list(description.nodes) == ["shape", "mine"]
    assert description.workspace == own
    file.write_text(text.replace("shapes.yaml", "shaped.yaml"), encoding="utf-8")
    (problem,) = resolve(file).problems
    assert problem.line == 3
    assert "did you mean 'softlab:shapes.yaml'?" in problem.message


def test_what_the_workspace_lacks_is_found_in_the_installed_one(own: Path, softlab: Path) -> None:
    assert load_class("nodes.mine:Shape", str(own)).__doc__ == "Of mine."
    assert load_class("nodes.round:Shape", str(own)).__doc__ == "Of softlab."
    assert source_of("nodes.shape:Shape", str(own)) == (softlab / "nodes/shape.py", "Shape")
    assert importlib.import_module("nodes.kinds.deep").__file__ == str(softlab / "nodes/kinds/deep.py")


def test_a_module_of_ones_own_takes_the_place_of_an_installed_one(own: Path, softlab: Path) -> None:
    shape = own / "nodes/shape.py"
    shape.write_text(SHAPE.format("ours"), encoding="utf-8")
    assert load_class("nodes.round:Shape", str(own)).__doc__ == "Of ours."
    assert source_of("nodes.shape:Shape", str(own)) == (shape, "Shape")
    assert hidden_modules(own) == [("nodes.shape", shape, softlab / "nodes/shape.py", "softlab")]
    shape.write_bytes((softlab / "nodes/shape.py").read_bytes())
    assert hidden_modules(own) == []


def test_a_module_has_one_identity_by_its_long_name_and_its_short_one(own: Path) -> None:
    long = importlib.import_module("softlab.rig.nodes.shape")
    assert long is importlib.import_module("nodes.shape")
    assert importlib.import_module("softlab.rig.nodes.round").Shape is long.Shape
    assert load_class("softlab.rig.nodes.shape:Shape", str(own)) is long.Shape
    assert source_of("softlab.rig.nodes.shape:Shape", str(own)) == source_of("nodes.shape:Shape", str(own))


def test_what_takes_a_modules_place_can_be_derived_from_it(own: Path) -> None:
    (own / "nodes/shape.py").write_text(
        "from softlab.rig.nodes.shape import Shape as Installed\nclass Shape(Installed):\n    'Of ours.'\n",
        encoding="utf-8",
    )
    ours = load_class("nodes.shape:Shape", str(own))
    assert [cls.__doc__ for cls in ours.__mro__[:2]] == ["Of ours.", "Of softlab."]
    assert load_class("nodes.round:Shape", str(own)) is ours


def test_a_swap_reads_the_source_again_whichever_name_it_has(own: Path, softlab: Path) -> None:
    assert load_class("nodes.shape:Shape", str(own)).__doc__ == "Of softlab."
    (softlab / "nodes/shape.py").write_text(SHAPE.format("SOFTLAB"), encoding="utf-8")
    assert load_class("softlab.rig.nodes.shape:Shape", str(own), fresh=True).__doc__ == "Of SOFTLAB."


def test_a_workspace_whose_package_is_gone_is_none(tmp_path: Path) -> None:
    install(tmp_path, "gone", {}, {underlays.GROUP: {"gone": "gone.rig", "none": "json"}})
    with forgetting() as patch:
        patch.syspath_prepend(str(tmp_path))
        assert [one.name for one in underlays.underlays()] == ["rig"]


def test_an_unknown_node_is_answered_with_where_it_was_looked_for(own: Path) -> None:
    from palp_core.graph.description.node_class import NodeClassRequest, inspect_classes

    (answer,) = inspect_classes([NodeClassRequest("nodes.shap:Shape")], own)
    assert answer.error is not None
    assert answer.error.startswith(f"no module 'nodes.shap' in {own}, nor in the installed 'softlab'")
    assert "did you mean 'nodes.shape'?" in answer.error


def test_the_rigs_classes_are_there_to_derive_from() -> None:
    with forgetting():
        enter_workspace(ROOT)
        long = importlib.import_module("palp_core.workspace.nodes.policy")
        assert long is importlib.import_module("nodes.policy")
        with pytest.raises(ModuleNotFoundError, match=r"palp_core\.workspace\.nodes\.polcy"):
            importlib.import_module("palp_core.workspace.nodes.polcy")


def test_reading_an_unknown_installed_file_is_a_mistake_with_its_reason() -> None:
    with pytest.raises(GraphError, match="there are: emulated"):
        resolve(Path("rig:nothing.yaml"))
