"""The JSON Schema of launch files, for editors: made from the keys that the checker goes by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from palp_core.graph.description.keys import LAUNCH_FILE, Key, Table, as_plain

DIALECT = "http://json-schema.org/draft-07/schema#"
"""Draft 7, the one that editors' YAML servers know."""

_SUBSTITUTION = {"type": "string", "pattern": r"\$\("}
_SELECTION = {
    "type": "object",
    "properties": {"select": {**_SUBSTITUTION, "description": "The argument that chooses: $(var name)."}},
    "required": ["select"],
}


def launch_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 7) of a launch file, as plain values.

    No key of the file itself is required, as a part that is only included has no ``graph`` and ``clock``;
    which arguments, parameters and wires there are, only ``palp launch FILE --check`` knows.
    """
    return {
        "$schema": DIALECT,
        "title": "palp launch file",
        "description": "A graph: which nodes, with which parameters, wired how.",
        **_table(LAUNCH_FILE, at_root=True),
    }


def _table(table: Table, *, at_root: bool = False) -> dict[str, Any]:
    required = [] if at_root else [name for name, key in table.items() if key.required]
    return {
        "type": "object",
        "properties": {name: _key(key) for name, key in table.items()},
        "additionalProperties": False,
        **({"required": required} if required else {}),
    }


def _key(key: Key) -> dict[str, Any]:
    about: dict[str, Any] = {"description": key.says.replace("`", "")}
    if key.default and key.form in ("flag", "whole", "number", "word"):
        about["default"] = as_plain(key, key.default)
    if key.form == "any":
        return about
    forms = [_form(key)]
    if key.short is not None:
        forms.append(_form(key.short))
    if key.selects:
        forms.append(_SELECTION)
    if key.form not in ("mapping", "list"):
        forms.append(_SUBSTITUTION)
    elif key.keys is None and key.each is None:
        forms += [_SUBSTITUTION, {"type": "null"}]
    return about | (forms[0] if len(forms) == 1 else {"anyOf": forms})


def _form(key: Key) -> dict[str, Any]:
    """Return the schema of a value as it is written without a substitution."""
    match key.form:
        case "word":
            return {"enum": list(key.words)}
        case "flag":
            return {"type": "boolean"}
        case "whole" | "number":
            kind = "integer" if key.form == "whole" else "number"
            most = {} if key.most is None else {"maximum": key.most}
            return {"type": kind, "minimum": key.least, **most}
        case "list":
            return {"type": "array", **({"items": _table(key.keys)} if key.keys is not None else {})}
        case "mapping":
            return _mapping(key.keys, key.each, key.short if key.each is not None else None)
    text: dict[str, Any] = {"type": "string"}
    return text if key.pattern is None else {**text, "pattern": f"^({_portable(key.pattern.pattern)})$"}


def _mapping(keys: Table | None, each: Table | None, short: Key | None) -> dict[str, Any]:
    if keys is not None:
        return _table(keys)
    if each is None:
        return {"type": "object"}
    inner: Mapping[str, Any] = _table(each)
    if short is not None:
        inner = {"anyOf": [inner, _form(short), _SUBSTITUTION]}
    return {
        "type": "object",
        "additionalProperties": inner,
    }


def _portable(pattern: str) -> str:
    """Return a pattern without Python's names of groups, which JSON Schema's do not have."""
    return pattern.replace("?P<module>", "").replace("?P<name>", "")
