"""Numbers that cannot be, and choices that contradict each other, are said with the launch file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from palp_core.graph.description.check import load
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.node.loading import load_class
from palp_core.graph.node.node import Node, declaration_of
from palp_core.graph.node.params import ParamDescription, describe_params
from palp_core.graph.problems import GraphProblems

ROOT = Path(__file__).parents[3]
TABLE = yaml.safe_load(Path(__file__).with_name("rig_mistakes.yaml").read_text(encoding="utf-8"))
LAUNCH = ROOT / "launch"
SHARED = ("parts/experiment.yaml", "parts/devices.yaml")  # of rig.yaml and emulated.yaml
PLACES = {"from_m", "to_m", "across_from_m", "across_to_m", "indentation_mm"}
"""What lies on an axis; all else is a size, a rate or a count."""


def found(path: Path, *arguments: str) -> list[tuple[str, str]]:
    """Return the text that each mistake points at, and what it says."""
    with pytest.raises(GraphProblems) as caught:
        load(path, arguments, inspect_classes)
    problems = caught.value.problems
    assert {problem.file for problem in problems} <= {
        str(path),
        *(str(path.parent / part) for part in SHARED),
    }
    lines = {p.file: Path(p.file).read_text(encoding="utf-8").splitlines() for p in problems}
    return [(lines[p.file][p.line - 1][p.column - 1 :], p.message) for p in problems]


@pytest.mark.parametrize("row", TABLE["out of range"])
def test_an_argument_out_of_its_range_is_one_mistake_that_names_each_node_that_takes_it(
    row: list[str],
) -> None:
    name, argument, *nodes = row
    variable = argument.partition(":=")[0].rpartition(".")[2]
    mistakes = found(LAUNCH / f"{name}.yaml", argument)
    named = [one for _, message in mistakes for one in re.findall(r"' \((\w+)\)", message)]
    assert sorted(named) == sorted(nodes)
    assert len({message.partition(": ")[2].partition("; argument")[0] for _, message in mistakes}) == len(
        mistakes
    )
    for place, message in mistakes:
        assert place.startswith(f"{variable}:")
        assert "does not fit: it must be" in message
        assert "give" in message


@pytest.mark.parametrize(("arguments", "place", "words"), TABLE["contradictions"])
def test_what_contradicts_scene_sensor_or_driver_is_a_mistake_where_it_stands(
    arguments: list[str], place: str, words: str, tmp_path: Path
) -> None:
    deep = tmp_path / "deep.yaml"
    deep.write_text("path: {indentation_m: 0.006}\n", encoding="utf-8")
    mistakes = found(LAUNCH / "rig.yaml", *(text.replace("DEEP", str(deep)) for text in arguments))
    assert any(where.startswith(place) and words in message for where, message in mistakes), mistakes


def test_what_is_wrong_in_all_branches_of_a_node_is_said_once() -> None:
    ((_, message),) = found(LAUNCH / "sim.yaml", "rings_mm:=0,x")
    assert message.endswith("; argument 'rings_mm' is also for 'experiment' (Experiment)")


def test_a_file_that_several_nodes_read_is_wrong_once_and_who_reads_it_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    ((_, message),) = found(LAUNCH / "sim.yaml", f"noise:={tmp_path}/pipe")
    assert message.startswith(
        f"node 'estimator' (Estimator): {tmp_path}/pipe: cannot read the noise file: it is a pipe, not a file"
    )
    assert re.findall(r"'(\w+)' \(", message) == ["estimator", "actuator", "phantom", "torque", "policy"]


@pytest.mark.parametrize("kind", ["actuator", "stage", "torque"])
def test_the_class_of_a_simulated_device_is_imported_by_the_check(kind: str, tmp_path: Path) -> None:
    for folder in ("nodes", "msgs", "launch/parts"):
        (tmp_path / Path(folder).name).symlink_to(ROOT / folder)
    before, _, after = (LAUNCH / "sim.yaml").read_text(encoding="utf-8").partition(f"  {kind}:\n")
    (tmp_path / "sim.yaml").write_text(
        f"{before}  {kind}:\n{after.replace('device: sim', 'device: my_lab:Device', 1)}", encoding="utf-8"
    )
    ((place, message),) = found(tmp_path / "sim.yaml")
    assert place.startswith("device: my_lab:Device")
    assert "cannot import 'my_lab:Device'" in message


@pytest.mark.parametrize("chosen", [["policy:=fixed"], ["policy:=information"]])
def test_other_positions_may_be_trained_where_the_policy_asks_for_no_others(chosen: list[str]) -> None:
    assert load(LAUNCH / "sim.yaml", ["rings_mm:=0, 16", *chosen], inspect_classes).nodes


@pytest.mark.parametrize(("old", "new", "words"), TABLE["lines"])
def test_a_line_of_the_launch_file_that_cannot_be_is_a_mistake_at_that_line(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    for folder in ("nodes", "msgs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    (tmp_path / "launch" / "parts").mkdir(parents=True)
    texts = {name: (LAUNCH / name).read_text(encoding="utf-8") for name in (*SHARED, "rig.yaml")}
    file = next(name for name in texts if old in texts[name])
    texts[file] = texts[file].replace(old, new, 1)
    for name, text in texts.items():
        (tmp_path / "launch" / name).write_text(text, encoding="utf-8")
    ((place, message),) = found(tmp_path / "launch" / "rig.yaml")
    assert words in message
    keys = re.findall(r"(\w+): ", new)
    assert place.startswith((*keys[:1], *keys[-1:], "stage: {", "torque: {", "rings_mm:"))


def numbers() -> Iterator[tuple[str, ParamDescription]]:
    """Return every parameter of a node that is a number."""
    for path in sorted((ROOT / "nodes").glob("*.py")):
        module = __import__(f"nodes.{path.stem}", fromlist=["*"])
        for name, cls in vars(module).items():
            if isinstance(cls, type) and issubclass(cls, Node) and cls.__module__ == module.__name__:
                loaded = load_class(f"{cls.__module__}:{name}", str(ROOT))
                for param in describe_params(declaration_of(loaded).params).values():
                    if param.type in ("int", "float"):
                        yield f"{name}.{param.name}", param


def test_every_number_that_a_node_takes_has_bounds_and_only_a_place_may_be_negative() -> None:
    known = dict(numbers())
    assert len(known) > 80
    assert [name for name, param in known.items() if param.minimum is None] == []
    assert [name for name, p in known.items() if p.maximum is None and p.type == "float"] == []
    signed = {param.name for param in known.values() if param.minimum is not None and param.minimum < 0}
    assert signed == PLACES
