"""Which parameters of a launch file do not fit the class."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.node.node import Declaration
from palp_core.graph.node.param_description import ParamDescription, describe_params
from palp_core.graph.node.params import load_params
from palp_core.graph.problems import hint, nearest


def param_errors(node: Declaration, given: Mapping[str, Any]) -> dict[str, str]:
    """Return what is wrong with given parameters: the first mistake of each, by name.

    What concerns a missing parameter is under its name; what concerns several together is under "".
    """
    kinds = typing.get_type_hints(node.params, include_extras=True)
    declared = describe_params(node.params)
    errors = {}
    for name, value in given.items():
        if name not in declared:
            errors[name] = f"there is no parameter '{name}'{hint(name, declared)}"
            continue
        try:
            msgspec.convert(value, kinds[name])
        except msgspec.ValidationError as error:
            errors[name] = f"parameter '{name}' does not fit: {error}; {_wanted(declared[name], value)}"
    meant = {nearest(name, declared) for name in errors if name not in declared}
    for name, param in declared.items():
        if param.required and name not in given and name not in meant:
            errors[name] = f"parameter '{name}' has no default; give it under params ({param.type})"
    if not errors:
        try:
            load_params(node, given, node.params.__name__)
        except GraphError as error:
            errors[""] = str(error)
    return errors


def _wanted(param: ParamDescription, value: Any) -> str:
    unit = f" in {param.unit}" if param.unit not in ("", "1") else ""
    low, high = param.minimum, param.maximum
    if low is not None and high is not None:
        bounds = f" from {low:g} to {high:g}"
    else:
        bounds = (
            f" of at least {low:g}"
            if low is not None
            else f" of at most {high:g}"
            if high is not None
            else ""
        )
    quoted = isinstance(value, str) and param.type in ("int", "float")
    return f"give {param.type}{bounds}{unit}" + (", without quotes" if quoted else "")
