"""The JSON Schemas of scene and phantom files, for editors: made from the classes that their reader fills."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Mapping
from typing import Any

from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import OUTPUTS, STRAINS, Scene, StagePath, Tolerance

SECTIONS: dict[str, tuple[str, type]] = {
    "": ("The file", Scene),
    "phantom": ("The phantom", Phantom),
    "phantom.bead": ("The bead", Bead),
    "probe": ("The probe", Probe),
    "path": ("The path", StagePath),
    "tolerance": ("The tolerance", Tolerance),
}
"""Title and class by the place in a scene file."""

WORDS: Mapping[str, tuple[str, ...]] = {"output": OUTPUTS, "strain": STRAINS}
"""All that a key may be whose value is a word."""

_DIALECT = "http://json-schema.org/draft-07/schema#"
_BARE = "none"  # in place of a bead


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 7) of a scene file, as plain values."""
    about = {"title": "palp scene file", "description": "What is swept over what, and how right it must be."}
    return {"$schema": _DIALECT, **about, **_mapping("", Scene)}


def phantoms_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 7) of a file of phantoms by code, as plain values."""
    return {
        "$schema": _DIALECT,
        "title": "palp phantom file",
        "description": "Phantoms by codes of one's own.",
        "type": "object",
        "minProperties": 1,
        "additionalProperties": _mapping("phantom", Phantom),
    }


def _mapping(place: str, kind: type) -> dict[str, Any]:
    said, limits = sentences(kind), limits_of(kind)
    fields = dataclasses.fields(kind)
    needed = [
        field.name
        for field in fields
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]
    found: dict[str, Any] = {
        "type": "object",
        "properties": {
            field.name: {
                "description": said[field.name].replace("`", ""),
                **_value(f"{place}.{field.name}".lstrip("."), field, limits.get(field.name)),
            }
            for field in fields
        },
        "additionalProperties": False,
    }
    return found | ({"required": needed} if needed else {})


def _value(place: str, field: dataclasses.Field[Any], limits: tuple[float, float] | None) -> dict[str, Any]:
    if place in SECTIONS:
        inner = _mapping(place, SECTIONS[place][1])
        return {"anyOf": [inner, {"enum": [_BARE, None]}]} if place == "phantom.bead" else inner
    if field.name in WORDS:
        return {"enum": list(WORDS[field.name])}
    if isinstance(field.default, str):
        return {"type": "string"}
    number: dict[str, Any] = {"type": "number"}
    if limits is not None:
        number |= {"minimum": limits[0], "maximum": limits[1]}
    if "tuple" in str(field.type):
        return {"anyOf": [number, {"type": "array", "items": number}]}
    return number


def sentences(kind: type) -> dict[str, str]:
    """Return what a class's docstring says of each attribute."""
    text = (inspect.getdoc(kind) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    found = re.findall(r"^    (\w+): (.*(?:\n {8,}.*)*)", text, flags=re.MULTILINE)
    plain = {name: re.sub(r":\w+:`~?([\w.]+)`", r"`\1`", " ".join(words.split())) for name, words in found}
    return {name: words.replace("``", "`").replace(" None", " `none`") for name, words in plain.items()}


def limits_of(kind: type) -> dict[str, tuple[float, float]]:
    """Return the least and the most that a class's constructor requires of each attribute."""
    checked = getattr(kind, "__post_init__", None)
    if checked is None:
        return {}
    found = {}
    for call in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(checked)))):
        if not isinstance(call, ast.Call) or ast.unparse(call.func) != "require":
            continue
        name, least, most = call.args[0], *call.args[2:4]
        if isinstance(name, ast.Constant):
            found[str(name.value)] = (float(ast.literal_eval(least)), float(ast.literal_eval(most)))
    return found
