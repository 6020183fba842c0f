"""The schema of launch files: it takes what the checker takes, and refuses what the checker refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from msgspec import inspect

from palp_core.graph.description.launch_keys import SECTIONS, launch_schema
from palp_core.graph.description.resolver import resolve
from tests.support.palp import ROOT, Palp

SCHEMA = launch_schema()
SHIPPED = ROOT / "launch" / "launch.schema.json"
FILES = [
    file
    for folder in ("launch", "examples", "benchmarks")
    for file in sorted((ROOT / folder).rglob("*.yaml"))
    if "launch" in file.parts
]


def objections(values: Any) -> list[str]:
    return [error.message for error in jsonschema.Draft7Validator(SCHEMA).iter_errors(values)]


def test_the_schema_is_one() -> None:
    jsonschema.Draft7Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_each_launch_file_of_the_repository_keeps_it(file: Path) -> None:
    assert objections(yaml.safe_load(file.read_text(encoding="utf-8"))) == []


def test_the_one_beside_the_rigs_launch_files_is_what_palp_prints(palp: Palp) -> None:
    printed = palp.printed("graph", "schema")
    assert json.loads(printed) == SCHEMA
    assert SHIPPED.read_text(encoding="utf-8") == printed, f"palp graph schema > {SHIPPED.relative_to(ROOT)}"


def base() -> dict[str, Any]:
    node = {"run": "some.module:Class", "inputs": {"INPUT": {"from": "other/port"}}, "restart": {}}
    return {
        "graph": "g",
        "clock": "wall",
        "args": {"NAME": {}},
        "include": [{"file": "included.yaml"}],
        "nodes": {"NODE": node},
        "checkpoint": {"file": "c", "after": "NODE/port", "nodes": ["NODE"]},
    }


def with_value(place: str, name: str, value: Any) -> dict[str, Any]:
    """Return a launch file that has a value at a key of a section."""
    values = found = base()
    for step in place.split("."):
        found = found[step.removesuffix("[]")] if step else found
        found = found[0] if isinstance(found, list) else found
    if name == "external":
        found.pop("from", None)
    found[name] = value
    return values


def mistakes(folder: Path, values: dict[str, Any]) -> str:
    """Return what the checker says of a launch file, but for what the made-up one has wrong anyway."""
    (folder / "included.yaml").write_text("args: {}\n", encoding="utf-8")
    file = folder / "made_up.yaml"
    file.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    found = [str(problem) for problem in resolve(file).problems]
    expected = ("is never used", "has no default and is not given")
    return "\n".join(line for line in found if not any(words in line for words in expected))


def plain(kind: inspect.Type) -> inspect.Type:
    """Return the type of a key without what is said of it; of several forms the plain one."""
    while isinstance(kind, inspect.Metadata | inspect.UnionType):
        kind = kind.type if isinstance(kind, inspect.Metadata) else kind.types[0]
    return kind


def wrong(kind: inspect.Type) -> list[Any]:
    """Return values that a key cannot have."""
    match plain(kind):
        case inspect.LiteralType() | inspect.BoolType():
            return ["unheard_of", 3]
        case inspect.IntType(ge=low) | inspect.FloatType(ge=low):
            return [(low or 0) - 1, "many"]
        case inspect.StrType(pattern=str()):
            return ["not one of those!", 7]
        case inspect.DictType() | inspect.StructType():
            return [7]
        case inspect.ListType():
            return [{"a": 1}]
    return []


def right(name: str, kind: inspect.Type) -> Any:
    """Return a value that a key may have."""
    if name == "checkpoint":
        return {"file": "kept", "after": "NODE/port", "nodes": ["NODE"]}
    if name in ("sets", "args"):
        return {}  # what it may name depends on what else stands there
    about = kind.extra_json_schema if isinstance(kind, inspect.Metadata) else None
    example = (about or {}).get("examples", [None])[0]
    if example is not None and "$(" not in str(example):
        return example
    match plain(kind):
        case inspect.LiteralType(values=words):
            return words[-1]
        case inspect.BoolType():
            return True
        case inspect.IntType() | inspect.FloatType():
            return 1
        case inspect.DictType():
            return {}
    return "text"


@pytest.mark.parametrize("place", SECTIONS)
def test_checker_and_schema_take_each_key_and_refuse_the_same_values(place: str, tmp_path: Path) -> None:
    for field in inspect.type_info(SECTIONS[place]).fields:  # type: ignore[attr-defined]
        name = field.encode_name
        good = with_value(place, name, right(name, field.type))
        assert objections(good) == [], name
        said = mistakes(tmp_path, good)
        assert f"key '{name}'" not in said
        assert f"{name} of" not in said
        assert f"{name} is" not in said
        for value in wrong(field.type):
            bad = with_value(place, name, value)
            assert objections(bad), f"the schema takes {name}: {value}"
            assert mistakes(tmp_path, bad), f"the checker takes {name}: {value}"


def test_a_misspelt_key_is_refused_by_both(tmp_path: Path) -> None:
    values = base() | {"colck": "sim"}
    assert any("colck" in text for text in objections(values))
    assert "did you mean 'clock'?" in mistakes(tmp_path, values)
