"""Every mistake in a launch file is reported at its place, with what to do, and once."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.node.spec import RESERVED_NAMES
from tests.graph.description.conftest import FILES, TABLE

VALID = FILES["one file"]["graph.yaml"]
ECHOING = {"an unknown argument", "an argument's strange name", "a node given twice", "a strange node name"}
ECHOING |= {"an output among the inputs", "a file that is not there", "a node that is there already"}
ECHOING |= {"broken YAML", "arguments that are a list", "by no choice", "a number for its values", "a list"}
"""After these mistakes it is reported, too, what is missing for them, or there twice."""


@pytest.mark.parametrize(
    ("files", "name"), [(files, name) for files, rows in TABLE["mistakes"].items() for name in rows]
)
def test_a_mistake_is_reported_at_its_place_with_what_to_do_and_without_echo(
    workspace: Any, files: str, name: str
) -> None:
    old, new, place, *words = TABLE["mistakes"][files][name]
    texts = {path: text.replace(old, new) if old else text for path, text in FILES[files].items()}
    for path, text in texts.items():
        workspace.write(f"launch/{path}", text)
    found = workspace.mistakes(texts["graph.yaml"], *([] if old else [new]))
    here = [one for one in found if place in one]
    assert any(all(word in one for word in words) for one in here), found
    assert len(here) == len(found) or name in ECHOING, found


def test_a_message_reads_file_line_column_and_what_to_do(workspace: Any) -> None:
    (text,) = workspace.mistakes(VALID.replace("estimator/belief", "estimtor/belief"))
    what = "node 'policy': input 'belief' comes from a node 'estimtor' that is not there"
    assert text == f"graph.yaml:21:22: {what}; did you mean 'estimator'?"


@pytest.mark.parametrize("name", sorted(RESERVED_NAMES))
def test_a_node_cannot_have_a_name_that_is_the_launchers_own(workspace: Any, name: str) -> None:
    (text,) = workspace.mistakes(VALID.replace("  record:\n", f"  {name}:\n"))
    what = f"'{name}' cannot be a node's name; it is the launcher's own: {RESERVED_NAMES[name]}"
    assert text == f"graph.yaml:22:3: {what}; choose another"


def test_all_mistakes_are_reported_together_those_of_one_wire_too(workspace: Any) -> None:
    text = (
        VALID.replace("gain: 1.5", "gain: fast").replace("on_exit", "on_exti").replace("seed: 7", "seeds: 7")
    )
    wire = "{from: torque/truth, durability: transient_local}"
    found = workspace.mistakes(text.replace("estimator/belief", wire))
    assert {one.split(":")[1] for one in found} == {"3", "13", "21", "25"}
    of_wire = " ".join(one for one in found if one.startswith("graph.yaml:21:"))
    assert "the publisher offers volatile" in of_wire
    assert "simulates or records" in of_wire


def test_a_file_without_nodes_and_an_empty_one_are_refused(workspace: Any) -> None:
    assert "no nodes" in workspace.mistakes("graph: g\nclock: sim\nnodes: {}\n")[0]
    assert "is empty" in workspace.mistakes("# nothing\n")[0]


def test_a_module_that_several_nodes_need_is_wrong_once(workspace: Any) -> None:
    workspace.write("msgs/touch.py", "import nowhere_at_all\n")
    (text,) = workspace.mistakes(VALID)
    assert text.startswith("graph.yaml:9:")
    assert "msgs/touch.py:1: ModuleNotFoundError: No module named 'nowhere_at_all'" in text


KEYS = ["graph", "clock", "args", "nodes", "report", "view", "default", "choices", "run", "params", "inputs"]
KEYS += [
    "restart",
    "when",
    "max_restarts",
    "on_exit",
    "from",
    "deadline_ms",
    "gain",
    "truth",
    "select",
    "device",
]


@settings(max_examples=40)
@given(key=st.sampled_from(KEYS), data=st.data())
def test_a_typo_in_any_key_is_reported_at_its_line(workspace: Any, key: str, data: st.DataObject) -> None:
    position = data.draw(st.integers(0, len(key) - 1))
    letter = data.draw(st.sampled_from("abcdefghijklmnopqrstuvwxyz"))
    insert = data.draw(st.booleans())
    typo = key[:position] + letter + key[position + (0 if insert else 1) :]
    if typo == key:
        return
    start = VALID.index(f"{key}: ") if f"{key}: " in VALID else VALID.index(f"{key}:\n")
    line = VALID.count("\n", 0, start) + 1
    found = workspace.mistakes(VALID[:start] + typo + VALID[start + len(key) :])
    assert any(one.startswith(f"graph.yaml:{line}:") and f"'{typo}'" in one for one in found), found
