"""A report knows its nodes by what they publish and how they are wired, and each number by its basis."""

from __future__ import annotations

import dataclasses
import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import PalpError
from palp_core.graph.launch.summary import RunSummary, summary_of
from palp_core.graph.node.node import Params
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.session.parameter_basis import BASIS, SCENE
from palp_core.palpation.session.report import session
from palp_core.palpation.session.roles import PUBLISHED, roles_of
from tests.support.palp import ROOT
from tests.support.rig_session import check_here
from tests.support.sessions import Summariser, Writer

TRIALS = [(0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]), (2, [[0.1, 0.2, 0.7]])]
RENAMED = {
    "experiment": "conductor",
    "policy": "chooser",
    "stage": "slide",
    "phantom": "gel",
    "estimator": "judge",
}


def renamed(run: RunSummary) -> RunSummary:
    """Return a run with every node renamed, and its topics."""

    def topic(name: str) -> str:
        node, _, rest = name.removeprefix("/").partition("/")
        return f"/{RENAMED[node]}/{rest}"

    publishes = {
        RENAMED[node]: {topic(name): kind for name, kind in topics.items()}
        for node, topics in run.publishes.items()
    }
    listens = {RENAMED[node]: [topic(name) for name in names] for node, names in run.listens.items()}
    params = {RENAMED[node]: values for node, values in run.params.items()}
    return msgspec.structs.replace(run, publishes=publishes, listens=listens, params=params)


def reported(run: RunSummary, out: Path) -> tuple[dict[str, Any], str]:
    session(run)
    return json.loads((out / "result.json").read_text()), (out / "report.html").read_text()


@pytest.mark.parametrize("name", ["sim", "emulated", "rig"])
def test_the_rigs_launch_files_have_every_role(name: str, tmp_path: Path) -> None:
    file = ROOT / "launch" / f"{name}.yaml"
    roles = roles_of(summary_of(check_here(file, [f"out:={tmp_path}"]), file))
    assert set(roles.node) == set(PUBLISHED)
    assert roles.touch_simulated is (name != "rig")


@pytest.mark.usefixtures("blank_charts")
def test_a_graph_with_every_node_renamed_gets_the_same_report(record: Writer, summary: Summariser) -> None:
    run = summary(out := record(trials=TRIALS))
    run.params["policy"] = {"ring_mm": 16.0}
    usual, usual_page = reported(run, out)
    result, page = reported(renamed(run), out)
    assert result.pop("roles") == {role: RENAMED[role] for role in usual.pop("roles")}
    assert result.pop("protocol") == {RENAMED[node]: of for node, of in usual.pop("protocol").items()}
    assert result == usual
    assert result["stop_rule"] is not None
    assert result["mechanics"] is not None
    for role, node in RENAMED.items():
        page = page.replace(f'<td class="name">{node}</td>', f'<td class="name">{role}</td>')
    assert page == usual_page
    assert "markov, 16 mm" in page


def test_a_missing_role_is_an_error_and_of_two_estimators_the_wired_one_counts(summary: Summariser) -> None:
    run = summary(Path("out"))
    run.publishes["a_shadow"] = {"/a_shadow/belief": "Belief"}
    assert roles_of(run).node["estimator"] == "estimator"
    run.listens["experiment"].append("/a_shadow/belief")
    with pytest.raises(PalpError, match="estimator and a_shadow publish Belief"):
        roles_of(run)
    for node in ("estimator", "a_shadow"):
        run.publishes.pop(node)
    with pytest.raises(PalpError, match=r"no node publishes Belief, .* knows no estimator; add the node, or"):
        roles_of(run)


def declared() -> Iterator[str]:
    """Yield each parameter of each node; policies count as one node."""
    for path in (ROOT / "nodes").glob("*.py"):
        for kind in vars(importlib.import_module(f"nodes.{path.stem}")).values():
            if isinstance(kind, type) and issubclass(kind, Params):
                yield from (f"{path.stem.partition('_')[0]}.{name}" for name in kind.__struct_fields__)


def test_each_basis_is_of_a_parameter_that_exists() -> None:
    assert set(BASIS) <= set(declared())


def test_every_number_of_the_simulated_scene_has_a_basis() -> None:
    numbers = {f.name for kind in (Probe, Phantom, Bead) for f in dataclasses.fields(kind)} - {"bead"}
    assert numbers == set(SCENE)
