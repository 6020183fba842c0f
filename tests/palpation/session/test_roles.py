"""A report knows its nodes by what they publish and how they are wired, not by their names."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import PalpError
from palp_core.graph.launch.checking import check_file
from palp_core.graph.launch.summary import RunSummary, summary_of
from palp_core.palpation.session.report import session
from palp_core.palpation.session.roles import PUBLISHED, roles_of
from tests.support.palp import ROOT, SIM
from tests.support.rig_session import check_here

Writer = Callable[..., Path]
Summariser = Callable[..., RunSummary]
TRIALS = [(0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]), (2, [[0.1, 0.2, 0.7]])]
RENAMED = {
    "experiment": "conductor",
    "policy": "chooser",
    "actuator": "ring",
    "stage": "slide",
    "phantom": "gel",
    "torque": "cell",
    "estimator": "judge",
    "emg": "muscle",
    "cocontraction": "effort",
}


def renamed(folder: Path) -> Path:
    """Return a copy of ``launch/sim.yaml`` with every node renamed."""
    for name in ("nodes", "msgs"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "launch" / "parts").mkdir(parents=True)
    for name in ("sim.yaml", "parts/experiment.yaml"):
        head, nodes = (SIM.parent / name).read_text(encoding="utf-8").split("\nnodes:\n")
        for old, new in RENAMED.items():
            nodes = re.sub(rf"^  {old}:$", f"  {new}:", nodes, flags=re.MULTILINE)
            head, nodes = (re.sub(rf": {old}/", f": {new}/", text) for text in (head, nodes))
        (folder / "launch" / name).write_text(f"{head}\nnodes:\n{nodes}", encoding="utf-8")
    return folder / "launch" / "sim.yaml"


def run_of(file: Path, out: Path) -> RunSummary:
    check = check_here if file == SIM else check_file  # another workspace has other nodes of these names
    checked = check(file, [f"out:={out}", "policy:=fixed"])
    outcome = {"exit_code": 0, "clock_s": 1.0, "wall_s": 1.0, "activation_count": 1}
    return msgspec.structs.replace(summary_of(checked, file, **outcome), file="launch file")


def reported(summary: RunSummary, out: Path) -> tuple[dict[str, Any], str]:
    session(summary)
    return json.loads((out / "result.json").read_text()), (out / "report.html").read_text()


@pytest.mark.parametrize("name", ["sim", "emulated", "rig"])
def test_the_rigs_launch_files_have_every_role(name: str, tmp_path: Path) -> None:
    checked = check_here(ROOT / "launch" / f"{name}.yaml", [f"out:={tmp_path}"])
    outcome = {"exit_code": 0, "clock_s": 1.0, "wall_s": 1.0, "activation_count": 1}
    roles = roles_of(summary_of(checked, Path(name), **outcome))
    assert set(roles.node) == set(PUBLISHED)
    assert roles.touch_simulated is (name != "rig")


@pytest.mark.usefixtures("blank_charts")
def test_a_graph_with_every_node_renamed_gets_the_same_report(record: Writer, tmp_path: Path) -> None:
    out = record(trials=TRIALS)
    usual, usual_page = reported(run_of(SIM, out), out)
    result, page = reported(run_of(renamed(tmp_path / "other"), out), out)
    assert result.pop("roles") == RENAMED
    assert usual.pop("roles") == {role: role for role in RENAMED}
    assert result.pop("protocol") == {RENAMED[node]: of for node, of in usual.pop("protocol").items()}
    for one in usual["methods"]:
        one["node"] = RENAMED.get(one["node"], one["node"])
    assert result == usual
    assert result["stop_rule"] is not None
    assert result["mechanics"] is not None
    for role, node in RENAMED.items():
        page = page.replace(f'<td class="name">{node}</td>', f'<td class="name">{role}</td>')
        page = page.replace(f"(/{node})", f"(/{role})")
    assert page == usual_page
    assert "fixed, 16 mm" in page


def test_a_missing_role_is_an_error_that_says_what_to_do(record: Writer, summary: Summariser) -> None:
    run = summary(record(trials=TRIALS))
    run.publishes.pop("estimator")
    said = (
        "launch/sim.yaml: no node publishes Belief, so the report knows no estimator; add the node, or leave"
    )
    with pytest.raises(PalpError, match=said):
        session(run)


def test_of_two_estimators_the_one_that_the_experiment_hears_from_counts(
    record: Writer, summary: Summariser
) -> None:
    run = summary(record(trials=TRIALS))
    run.publishes["a_shadow"] = {"/a_shadow/belief": "Belief"}
    run.params["a_shadow"] = {"stop": "fixed_number", "stop_value": 3.0}
    assert roles_of(run).node["estimator"] == "estimator"
    run.listens["experiment"].append("/a_shadow/belief")
    with pytest.raises(PalpError, match="estimator and a_shadow publish Belief"):
        roles_of(run)
