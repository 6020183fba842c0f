"""Every key and value knows its place; substitutions keep types where they should."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.description.arguments import Argument
from palp_core.graph.description.source_file import SourceFile
from palp_core.graph.description.yaml_tree import UNKNOWN, Mapping, Scalar, Sequence, read_tree
from palp_core.graph.problems import GraphProblems, Mark, Problems


def tree_of(tmp_path: Path, text: str) -> tuple[Any, Problems]:
    path, problems = tmp_path / "a.yaml", Problems()
    path.write_text(text, encoding="utf-8")
    return read_tree(path, problems), problems


def test_keys_and_values_know_line_and_column(tmp_path: Path) -> None:
    tree, problems = tree_of(tmp_path, "a:\n  b: [1, {c: d}]\n")
    entry = tree.items["a"].value.items["b"]
    assert (entry.mark.line, entry.mark.column) == (2, 3)
    assert isinstance(entry.value, Sequence)
    inner = entry.value.items[1]
    assert isinstance(inner, Mapping)
    assert inner.items["c"].value.mark[1:] == (2, 14)
    assert not len(problems)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("on", "on"),
        ("no", "no"),
        ("true", True),
        ("0x10", 16),
        ("12:30", "12:30"),
        ("'5'", "5"),
        ("!!str 5", "5"),
        ("~", None),
        (".inf", float("inf")),
        ("-.5", -0.5),
        ("1.2.3", "1.2.3"),
    ],
)
def test_scalars_follow_yaml_1_2(tmp_path: Path, text: str, value: Any) -> None:
    tree, _ = tree_of(tmp_path, f"a: {text}\n")
    found = tree.items["a"].value
    assert isinstance(found, Scalar)
    assert found.value == value
    assert type(found.value) is type(value)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("a: 1\nb:\n  c: 2\n  c: 3\n", 4, "'c' is given twice (first at line 3)"),
        ("a: &x [*x]\n", 1, "refers to itself"),
        ("a: !thing 5\n", 1, "no meaning"),
        ("a: &x {b: 1}\nc:\n  <<: *x\n  d: 2\n", 3, "merge keys (<<) are not read"),
        ("a: &x {b: 1}\nc: {d: 2, << : [*x, {e: 1}]}\n", 2, "merge keys (<<) are not read"),
        ("? [a]\n: 1\n", 1, "single word"),
    ],
)
def test_what_yaml_allows_but_a_graph_does_not_is_located(
    tmp_path: Path, text: str, line: int, words: str
) -> None:
    _, problems = tree_of(tmp_path, text)
    assert any(p.line == line and words in p.message for p in problems.listed())


def test_a_quoted_key_of_two_angles_is_a_key(tmp_path: Path) -> None:
    tree, problems = tree_of(tmp_path, "a: {'<<': 1}\n")
    assert list(tree.items["a"].value.items) == ["<<"]
    assert not len(problems)


@pytest.mark.parametrize(
    ("data", "line"),
    [(b"a: 1\nb: [\n", 3), (b"a: 1\n\tb: 2\n", 2), (b"a: 1\nb: \x07\n", 2), (b"a: \xff\n", 1)],
)
def test_what_is_not_yaml_is_located(tmp_path: Path, data: bytes, line: int) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(data)
    with pytest.raises(GraphProblems) as caught:
        read_tree(path, Problems())
    assert caught.value.problems[0].line == line


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(GraphProblems, match=r"none\.yaml:1:1: cannot be read: No such file"):
        read_tree(tmp_path / "none.yaml", Problems())


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("$(var rate)", 2.5),
        ("'$(var rate)'", 2.5),
        ("$(var live)", True),
        ("at $(var rate) Hz", "at 2.5 Hz"),
        ("$(var live)/$(var live)", "true/true"),
        ("$(env PORT)", 5),
        ("'$(env PORT)'", "5"),
        ("$(env NONE 7.5)", 7.5),
        ("$(env NONE some words)", "some words"),
        ("$(filename)", "folder/a.yaml"),
        ("$(dirname)/b.csv", "folder/b.csv"),
        ("costs $5", "costs $5"),
        ("$(var rat)", UNKNOWN),
        ("x $(var)", UNKNOWN),
        ("$(dirname x)", UNKNOWN),
        ("$(env A $(var rate))", UNKNOWN),
    ],
)
def test_substitutions_keep_types_where_they_stand_alone(tmp_path: Path, text: str, value: Any) -> None:
    tree, problems = tree_of(tmp_path, f"a: {text}\n")
    here = Mark("a.yaml", 1, 1)
    file = SourceFile(Path("folder/a.yaml"), {}, problems, {"PORT": "5"}, "now", {}, here)
    file.take({name: Argument(name, here, known) for name, known in (("rate", 2.5), ("live", True))})
    found = file.evaluate(tree.items["a"].value)
    assert found == value
    assert type(found) is type(value)
    assert len(problems) == (1 if value is UNKNOWN else 0)
