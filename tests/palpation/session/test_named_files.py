"""What files that parameters name say is checked with the launch file, before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.description.check import load
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.problems import GraphProblems

LAUNCH = Path(__file__).parents[3] / "launch"


@pytest.mark.parametrize("name", ["sim", "emulated", "rig", "replay"])
def test_a_bad_scene_file_is_a_mistake_at_the_parameter_that_names_it(name: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("phantom: {modulus_pa: -5}\n", encoding="utf-8")
    with pytest.raises(GraphProblems) as caught:
        load(LAUNCH / f"{name}.yaml", [f"scene:={scene}"], inspect_classes)
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
    assert load(LAUNCH / "sim.yaml", files, inspect_classes).nodes
    phantoms.write_text("X: {bed: none}\n", encoding="utf-8")
    with pytest.raises(GraphProblems, match=r"phantoms\.yaml:1:5: phantom 'X' has no key 'bed'") as caught:
        load(LAUNCH / "sim.yaml", [*files, "scene:=nowhere.yaml"], inspect_classes)
    assert "nowhere.yaml: cannot read the scene: No such file" in str(caught.value)
