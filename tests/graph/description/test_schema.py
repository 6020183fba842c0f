"""The schema of launch files: it takes what the checker takes, and refuses what the checker refuses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from palp_core.graph.description.file_reader import read
from palp_core.graph.description.keys import ARGUMENT, INCLUDE, LAUNCH_FILE, SECTIONS, Key
from palp_core.graph.description.schema import launch_schema
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
    printed = palp.run("graph", "schema")
    assert printed.returncode == 0
    assert json.loads(printed.stdout) == SCHEMA
    assert SHIPPED.read_text(encoding="utf-8") == printed.stdout, (
        f"palp graph schema > {SHIPPED.relative_to(ROOT)}"
    )


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
    found = [str(problem) for problem in read(file).problems]
    expected = ("is never used", "has no default and is not given")
    return "\n".join(line for line in found if not any(words in line for words in expected))


def wrong(key: Key) -> Iterator[Any]:
    """Yield values that a key cannot have."""
    match key.form:
        case "word":
            yield "unheard_of"
        case "flag":
            yield from ("yes please", 3)
        case "whole" | "number":
            yield from (key.least - 1, "many")
            if key.most is not None:
                yield key.most + 1
            if key.form == "whole":
                yield 1.5
        case "text" if key.pattern is not None:
            yield from ("not one of those!", 7)
        case "mapping":
            if key.short is None:
                yield 7
        case "list":
            yield {"a": 1}


def right(key: Key) -> Any:
    """Return a value that a key may have."""
    if key is LAUNCH_FILE["checkpoint"]:
        return {"file": "kept", "after": "NODE/port", "nodes": ["NODE"]}
    if key is ARGUMENT["sets"] or key is INCLUDE["args"]:
        return {}  # what it may name depends on what else stands there
    if key.words:
        return key.words[-1]
    if key.example and "$(" not in key.example:
        return yaml.safe_load(key.example)
    return {"flag": True, "whole": max(1, key.least), "number": 1.5, "mapping": {}}.get(key.form, "text")


KEYS = [(place, name, key) for place, (_, table) in SECTIONS.items() for name, key in table.items()]
IDS = [f"{place}.{name}" for place, name, _ in KEYS]


@pytest.mark.parametrize(("place", "name", "key"), KEYS, ids=IDS)
def test_checker_and_schema_take_each_key_and_refuse_the_same_values(
    place: str, name: str, key: Key, tmp_path: Path
) -> None:
    good = with_value(place, name, right(key))
    assert objections(good) == []
    said = mistakes(tmp_path, good)
    assert f"key '{name}'" not in said
    assert f"{name} of" not in said
    assert f"{name} is" not in said
    for value in wrong(key):
        bad = with_value(place, name, value)
        assert objections(bad), f"the schema takes {name}: {value}"
        assert mistakes(tmp_path, bad), f"the checker takes {name}: {value}"


def test_a_misspelt_key_is_refused_by_both(tmp_path: Path) -> None:
    values = base() | {"colck": "sim"}
    assert any("colck" in text for text in objections(values))
    assert "did you mean 'clock'?" in mistakes(tmp_path, values)
    assert set(SCHEMA["properties"]) == set(LAUNCH_FILE)
