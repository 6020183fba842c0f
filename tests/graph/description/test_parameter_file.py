"""Parameter files in ROS 2's form: what does not fit is said with its place, and nothing is set."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.description.parameter_file import read_parameter_file
from palp_core.graph.problems import GraphProblems

KNOWN = {"gain": 1.0, "fail_at": -1, "mode": "on"}


def read(tmp_path: Path, text: str, **options: bool) -> dict[str, object]:
    file = tmp_path / "p.yaml"
    file.write_text(text)
    return read_parameter_file(file, "relay", KNOWN, **options)


@pytest.mark.parametrize("name", ["/relay", "relay", "/**"])
def test_a_node_is_named_with_slash_without_it_or_by_the_wildcard(tmp_path: Path, name: str) -> None:
    text = f"{name}:\n  ros__parameters: {{gain: 1e-3, mode: off}}\n"
    assert read(tmp_path, text) == {"gain": 1e-3, "mode": "off"}


def test_the_nodes_own_entry_goes_before_the_wildcard(tmp_path: Path) -> None:
    text = "/relay: {ros__parameters: {gain: 3.0}}\n/**: {ros__parameters: {gain: 2.0, fail_at: 5}}\n"
    assert read(tmp_path, text) == {"gain": 3.0, "fail_at": 5}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("/sink: {ros__parameters: {gain: 3.0}}", "1:1: '/sink' is not /relay"),
        (
            "/relay: {ros__parameters: {gian: 3.0}}",
            "1:28: /relay has no parameter 'gian'; did you mean 'gain'",
        ),
        ("/relay: {ros__parameters: {gain: 3.0, gain: 4.0}}", "key 'gain' is given twice"),
        ("/relay: {gain: 3.0}", "'/relay' must hold one key, ros__parameters"),
        ("/relay: 5", "'/relay' must hold one key, ros__parameters"),
        ("/relay: {ros__parameters: 5}", "'/relay' must hold one key, ros__parameters"),
        ("", "is empty"),
        ("[1]", "is no parameter file"),
        ("a: [", "not valid YAML"),
    ],
)
def test_a_mistake_is_said_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(GraphProblems) as problems:
        read(tmp_path, text)
    assert said in str(problems.value)


def test_the_wildcard_can_be_refused(tmp_path: Path) -> None:
    with pytest.raises(GraphProblems, match="is not /relay"):
        read(tmp_path, "/**: {ros__parameters: {gain: 3.0}}", wildcard=False)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(GraphProblems, match="cannot be read"):
        read_parameter_file(tmp_path / "none", "relay", KNOWN)
