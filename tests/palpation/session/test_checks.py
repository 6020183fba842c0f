"""What the check of a launch file says of its parameters, of the files that they name, and of long blocks."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import msgspec
import pytest

from nodes.rig_stage import RigStage
from nodes.rig_torque import RigTorque, RigTorqueParams
from nodes.stage import Stage, StageParams
from palp_core import Bench
from palp_core.errors import DeviceError
from palp_core.graph.description.check import load
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.launch.checking import check_start
from palp_core.graph.launch.summary import RunSummary, summary_of
from palp_core.graph.problems import GraphProblems
from palp_core.palpation.devices.blocks import LONGEST_S, check_block, late_blocks
from palp_core.palpation.session.methods.advice import advice
from tests.support.palp import SIM
from tests.support.rig_session import check_here


@pytest.fixture(scope="module")
def runs() -> list[RunSummary]:
    return [summary_of(check_here(path), path) for path in (SIM, SIM.with_name("emulated.yaml"))]


def changed(run: RunSummary, node: str, **params: Any) -> RunSummary:
    return msgspec.structs.replace(run, params=run.params | {node: run.params[node] | params})


def test_the_launch_files_of_palp_need_no_advice(runs: list[RunSummary]) -> None:
    """No block that they give is late for its reader, nor is a stage too fast."""
    rig = SIM.with_name("rig.yaml")
    more = (summary_of(check_here(SIM, ["reading:=trace"]), SIM), summary_of(check_here(rig), rig))
    for run in (*runs, *more):
        assert advice(run) == []


def test_of_a_stage_that_is_faster_than_the_computed_touch_is_bounded_for_it_says_how_fast_it_may_be(
    runs: list[RunSummary],
) -> None:
    for run in runs:
        assert advice(changed(run, "stage", sweep_speed_m_s=0.05)) == []
        (words,) = advice(changed(run, "stage", sweep_speed_m_s=0.08))
        assert words.startswith("/stage: sweep_speed_m_s: 0.08: inertia: quasi_static")
        assert words.endswith("sweep at 0.05 m/s or slower")
    finer = changed(changed(runs[0], "phantom", tolerance=0.01), "stage", sweep_speed_m_s=0.03)
    assert advice(finer)[0].endswith("sweep at 0.02 m/s or slower")


def test_of_samples_that_come_later_than_asked_it_says_how_long_blocks_may_be(runs: list[RunSummary]) -> None:
    sim, emulated = runs
    assert sim.params["stage"]["block_samples"] > 50  # of a feature nothing is acted upon within a sweep
    (words,) = advice(changed(sim, "stage", block_samples=51, within_sweep=True))
    assert words.startswith("/stage: block_samples: 51: the torque comes in blocks of 0.051 s")
    assert words.endswith("give 50 at most, at 1000 Hz")
    (words,) = advice(changed(emulated, "torque", block_samples=41))
    assert words.endswith("give 40 at most, at 1000 Hz")
    (words,) = advice(changed(emulated, "emg", block_samples=150))
    assert words.startswith("/emg: block_samples: 150: the emg comes in blocks of 0.1 s")
    (words,) = advice(changed(emulated, "torque", load_hz=100.0))
    assert words.endswith("give 345 at least")


def test_a_policy_that_is_to_take_over_in_a_trial_that_there_will_not_be_is_named(
    runs: list[RunSummary],
) -> None:
    sim, late = runs[0], "12=nodes.policy_markov:Markov, 300=nodes.policy_uniform:Uniform"
    (words,) = advice(changed(sim, "experiment", trials=4, swaps=late))
    assert words == (
        "/experiment: swaps: 300=nodes.policy_uniform:Uniform: uniform never takes over: "
        "trials are counted from 1 to 12, over all phantoms"
    )
    assert advice(changed(sim, "experiment", trials=100, swaps=late)) == []
    never = advice(changed(sim, "experiment", plan="repeatability", swaps=late))
    assert [words.endswith("never takes over: it has no trials") for words in never] == [True, True]


def test_a_stage_or_ring_that_an_emulated_phantom_does_not_follow_is_named(runs: list[RunSummary]) -> None:
    sim, emulated = runs
    for node in ("stage", "actuator"):
        assert advice(changed(sim, node, device="drivers.mine:Mine")) == []
        (words,) = advice(changed(emulated, node, device="drivers.mine:Mine"))
        assert words.startswith(f"/{node}: device: drivers.mine:Mine: the emulated phantom follows emulated")


def test_the_check_of_a_launch_file_says_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    checked = check_here(SIM)
    assert check_start(SIM, checked) == []
    faster = [
        msgspec.structs.replace(spec, params=spec.params | {"sweep_speed_m_s": 0.5})
        for spec in checked.nodes
        if spec.name == "stage"
    ]
    nodes = [*(spec for spec in checked.nodes if spec.name != "stage"), *faster]
    (words,) = check_start(SIM, msgspec.structs.replace(checked, nodes=nodes))
    assert "sweep at 0.05 m/s or slower" in words


def test_blocks_of_more_than_a_second_are_refused_in_words() -> None:
    check_block(1000, 1000.0)
    text = f"a block of 1500 samples at 1000 Hz lasts 1.5 s, .* give {1000 * LONGEST_S:g} at most"
    with pytest.raises(DeviceError, match=text):
        check_block(1500, 1000.0)
    assert "block_samples" in RigTorque.examine(RigTorqueParams(block_samples=1001))
    assert "block_samples" in Stage.examine(StageParams(block_samples=1001))


def test_blocks_that_are_late_for_their_reader_are_reported_at_the_start(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        Bench(Stage, {"block_samples": 50})
        Bench(RigStage, {"device": "sim", "block_samples": 100})  # a sensor of its own streams the torque
        assert not caplog.records
        Bench(Stage, {"block_samples": 100})
    assert "the torque comes in blocks of 0.1 s" in caplog.text
    assert "0.05 s are wanted" in caplog.text
    assert late_blocks("load", 1 / 345, wall_clock=True) == ""
    assert late_blocks("load", 1 / 344, wall_clock=True) != ""


@pytest.mark.parametrize("name", ["sim", "emulated", "rig", "replay"])
def test_a_bad_scene_file_is_a_mistake_at_the_parameter_that_names_it(name: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("phantom: {modulus_pa: -5}\n", encoding="utf-8")
    with pytest.raises(GraphProblems) as caught:
        load(SIM.with_name(f"{name}.yaml"), [f"scene:={scene}"], inspect_classes)
    lines = str(caught.value).splitlines()
    assert any("(Estimator)" in line for line in lines)
    for line in lines:
        assert f"{scene}:1:23: modulus_pa: -5 is not in" in line
        file, number = line.split(":")[:2]
        assert "scene: $(var scene)" in Path(file).read_text(encoding="utf-8").splitlines()[int(number) - 1]


def test_files_of_scene_and_phantoms_are_each_checked_and_good_ones_pass(tmp_path: Path) -> None:
    scene, phantoms = tmp_path / "scene.yaml", tmp_path / "phantoms.yaml"
    scene.write_text("ring_m: [0.008]\n", encoding="utf-8")
    beads = "".join(f"{code}: {{bead: {{depth_m: 0.00{code[1]}}}}}\n" for code in ("X3", "X5", "X7"))
    phantoms.write_text(beads, encoding="utf-8")
    files = [f"scene:={scene}", f"phantoms:={phantoms}"]
    assert load(SIM, files, inspect_classes).nodes
    phantoms.write_text("X: {bed: none}\n", encoding="utf-8")
    with pytest.raises(GraphProblems, match=r"phantoms\.yaml:1:5: phantom 'X' has no key 'bed'") as caught:
        load(SIM, [*files, "scene:=nowhere.yaml"], inspect_classes)
    assert "nowhere.yaml: cannot read the scene: No such file" in str(caught.value)
