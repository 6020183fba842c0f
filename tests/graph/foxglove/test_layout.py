"""The layout that is shipped, held against Foxglove's own description of layouts: the classes of its SDK."""

from __future__ import annotations

import dataclasses
import json
import re
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest

layouts: Any = pytest.importorskip("foxglove.layouts")
FILE = Path(__file__).resolve().parents[3] / "launch" / "rig.foxglove.json"
LAYOUT: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
TITLE = "foxglovePanelTitle"
PANELS = {
    words["panelType"]: type(words["config"])
    for words in (
        getattr(layouts, name)()._to_dict()
        for name in dir(layouts)
        if name.endswith("Panel") and name not in ("BasePanel", "Panel")
    )
}
"""The class of each kind of panel's configuration."""
IN_FILES = {"RosOut": "Log"}
"""A file that the application writes calls one kind by its old name."""


def camel(name: str) -> str:
    return re.sub("_([a-z])", lambda found: found[1].upper(), name)


def misfits(value: Any, kind: Any, where: str) -> Iterator[str]:
    """Yield what the SDK would not write so."""
    if dataclasses.is_dataclass(kind):
        known = {camel(field): hint for field, hint in get_type_hints(kind, vars(layouts)).items()}
        yield from (f"{where}.{name}: Foxglove knows no such key" for name in value.keys() - known.keys())
        for name in value.keys() & known.keys():
            yield from misfits(value[name], known[name], f"{where}.{name}")
    elif get_origin(kind) in (Union, types.UnionType):
        found = [list(misfits(value, one, where)) for one in get_args(kind)]
        yield from () if [] in found else found[0]
    elif get_origin(kind) is list:
        for place, item in enumerate(value if isinstance(value, list) else [value]):
            yield from misfits(item, get_args(kind)[0], f"{where}[{place}]")
    elif get_origin(kind) is dict:
        for name, item in value.items():
            yield from misfits(item, get_args(kind)[1], f"{where}.{name}")
    elif get_origin(kind) is Literal:
        if value not in get_args(kind):
            yield f"{where}: {value!r} is none of {get_args(kind)}"
    elif kind is type(None):  # it has no settings
        if value not in (None, {}):
            yield f"{where}: {value!r} is nothing that it knows"
    elif kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            yield f"{where}: {value!r} is no number"
    elif kind is not Any and not isinstance(value, kind):
        yield f"{where}: {value!r} is no {kind.__name__}"


@pytest.mark.parametrize("panel", LAYOUT["configById"])
def test_a_panel_is_one_that_foxglove_has_with_settings_that_it_has(panel: str) -> None:
    kind, _, name = panel.partition("!")
    config = {key: value for key, value in LAYOUT["configById"][panel].items() if key != TITLE}
    assert name
    assert LAYOUT["configById"][panel][TITLE]
    assert list(misfits(config, PANELS[IN_FILES.get(kind, kind)], panel)) == []


def tiles(at: Any) -> Iterator[str]:
    """Yield the panels of a tiling, which halves and halves again."""
    if isinstance(at, str):
        yield at
        return
    assert at.keys() == {"direction", "first", "second", "splitPercentage"}
    assert at["direction"] in ("row", "column")
    assert 0 < at["splitPercentage"] < 100
    yield from tiles(at["first"])
    yield from tiles(at["second"])


def test_it_has_the_parts_of_a_layout_and_each_panel_one_place() -> None:
    assert LAYOUT.keys() == {"configById", "globalVariables", "layout", "playbackConfig", "userNodes"}
    assert sorted(tiles(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
