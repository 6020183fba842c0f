"""A session gets a method for each task from the register, and keeps what is published."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from palp_core.graph.problems import GraphProblems
from palp_core.methods import names, tasks
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.session.method_choices import AUTO, choose_for, chosen_method, launch_defaults
from palp_core.palpation.studies.schemes import POLICIES
from tests.support.rig_session import ComposedGraph, check_here

ROOT = Path(__file__).resolve().parents[2]


def test_every_policy_of_a_study_is_one_of_the_register() -> None:
    suffix = re.compile(r"_(best|stiff|stationary|reversed|permuted|\d+)$")
    without_suffix = {suffix.sub("", name) for name in POLICIES}
    assert without_suffix - {"chance", "best_single_probe"} <= set(names("policy"))


def test_the_published_session_gets_a_method_for_every_task() -> None:
    for task in (one.name for one in tasks()):
        chosen = chosen_method(task, Scene())
        assert chosen.bound is not None, task
        assert chosen.bound <= chosen.tolerance, task
        assert chosen_method(task, Scene(), asked=chosen.name).asked, task


KEPT_BECAUSE_PUBLISHED = {
    "denoise": "soft_universal",
    "feature": "peak",
    "filter": "naive",
    "policy": "markov",
    "stop": "paper_guarded",
}


def test_each_default_of_a_run_is_chosen_or_kept_because_it_is_published() -> None:
    defaults, kept = launch_defaults(), {}
    for one in tasks():
        choice = choose_for(one, Scene(), default=defaults.get(one.name, AUTO))
        assert choice.chosen is not None
        if choice.default not in (AUTO, choice.chosen.name):
            kept[one.name] = choice.default
            assert choice.points is not None
    assert kept == KEPT_BECAUSE_PUBLISHED


def test_the_protocol_auto_takes_every_task_from_the_register() -> None:
    arguments = yaml.safe_load((ROOT / "launch/parts/experiment.yaml").read_text(encoding="utf-8"))["args"]
    left = {one.name for one in tasks()} - {"contact", "motion", "burst"}  # no launch file names these
    assert arguments["protocol"]["sets"][AUTO] == dict.fromkeys(left, AUTO)


def test_the_register_chooses_for_a_rig_or_refuses_before_anything_starts() -> None:
    check_here(ROOT / "launch" / "sim.yaml", ["protocol:=auto", "training:=25"])
    with pytest.raises(GraphProblems) as refused:
        check_here(ROOT / "launch" / "sim.yaml", ["protocol:=auto", "training:=5"])
    for task in ("feature", "likelihood", "stop", "policy"):
        assert f"no {task} method gives" in str(refused.value)


@pytest.mark.nightly
def test_the_registers_choice_decides_a_session(tmp_path: Path) -> None:
    with ComposedGraph(
        str(ROOT / "launch" / "sim.yaml"), out=str(tmp_path / "out"), trials=1, training=25,
        rings_mm="8, 16", protocol="auto",
    ) as graph:  # fmt: skip
        graph.run()
    rows = (tmp_path / "out" / "trials.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) > 1 + 3 * 2 * 25
