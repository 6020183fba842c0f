"""What parameters a node class declares, and which of the given ones do not fit."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.launch.problems import hint, nearest
from palp_core.runtime.node import Declaration, Params
from palp_core.runtime.params import load_params

__all__ = ["ParamDescription", "describe_params", "param_errors"]


class ParamDescription(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter.

    Attributes:
        type: As in Python: ``float``, ``list[str]``, ``Literal['sim', 'xeryon']``.
        unit: SI unit; "" when none is stated.
        required: It has no default.
        default: Default as a plain value; None when required.
        minimum: Smallest value; None when not bounded.
        maximum: Largest value; None when not bounded.
    """

    name: str
    type: str
    unit: str = ""
    required: bool = False
    default: Any = None
    minimum: float | None = None
    maximum: float | None = None


def describe_params(cls: type[Params]) -> dict[str, ParamDescription]:
    """Return what a parameter class declares, by name."""
    info = msgspec.inspect.type_info(cls)
    assert isinstance(info, msgspec.inspect.StructType)
    return {field.encode_name: _describe(field) for field in info.fields}


def _describe(field: msgspec.inspect.Field) -> ParamDescription:
    kind, unit = field.type, ""
    if isinstance(kind, msgspec.inspect.Metadata):
        unit = (kind.extra_json_schema or {}).get("x-unit", "")
        kind = kind.type
    default = None
    if field.default is not msgspec.NODEFAULT:
        default = msgspec.to_builtins(field.default)
    elif field.default_factory is not msgspec.NODEFAULT:
        default = msgspec.to_builtins(field.default_factory())
    return ParamDescription(
        name=field.encode_name,
        type=_type_text(kind),
        unit=unit,
        required=field.required,
        default=default,
        minimum=getattr(kind, "ge", None),
        maximum=getattr(kind, "le", None),
    )


def _type_text(kind: msgspec.inspect.Type) -> str:
    match kind:
        case msgspec.inspect.Metadata():
            return _type_text(kind.type)
        case msgspec.inspect.LiteralType():
            return f"Literal[{', '.join(map(repr, kind.values))}]"
        case msgspec.inspect.ListType():
            return f"list[{_type_text(kind.item_type)}]"
        case msgspec.inspect.VarTupleType():
            return f"tuple[{_type_text(kind.item_type)}, ...]"
        case msgspec.inspect.DictType():
            return f"dict[{_type_text(kind.key_type)}, {_type_text(kind.value_type)}]"
        case msgspec.inspect.StructType() | msgspec.inspect.EnumType() | msgspec.inspect.CustomType():
            return kind.cls.__name__
    return type(kind).__name__.removesuffix("Type").lower()


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
