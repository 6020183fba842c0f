"""A node's parameters: what its class declares, and plain values made into them, validated as a whole."""

import inspect
from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError, in_words
from palp_core.graph.node.node import Declaration, Params
from palp_core.graph.node.ports import Timer

SLOWEST_HZ, FASTEST_HZ = 1e-9, 1e9  # the grid of ticks is in whole ns


def load_params(declared: Declaration, values: Mapping[str, Any], where: str) -> Params:
    try:
        params = msgspec.convert(dict(values), declared.params)
    except msgspec.ValidationError as error:
        raise GraphError(f"{where}: parameters: {in_words(error)}") from error
    for name, timer in declared.of(Timer).items():
        rate_hz = getattr(params, timer.hz)
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise GraphError(
                f"{where}: parameters: '{timer.hz}' is the rate of '{name}': {rate_hz:g} is no rate"
            )
    return params


def changed_params(declared: Declaration, present: Params, changes: Mapping[str, Any], where: str) -> Params:
    before = msgspec.to_builtins(present)
    for name in changed_read_only(describe_params(declared.params), before, changes):
        raise GraphError(
            f"{where}: parameter '{name}' is read-only: it is looked at when the node is configured; "
            "state it in the launch file"
        )
    return load_params(declared, {**before, **changes}, where)


class ParamDescription(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter.

    Attributes:
        description: What ``Annotated[float, Meta(description="...")]`` says of it; "" when nothing.
        type: As in Python: ``float``, ``list[str]``, ``Literal['sim', 'xeryon']``.
        unit: SI unit; "" when none is stated.
        required: It has no default.
        default: Default as a plain value; None when required.
        minimum: Smallest value; None when not bounded.
        maximum: Largest value; None when not bounded.
        choices: The values allowed; empty when any is. Those of a Literal, or what a function says that a
            parameter names: ``Annotated[str, Meta(extra={"choices": function})]``.
        read_only: It cannot be changed while the node lives.
    """

    name: str
    description: str = ""
    type: str
    unit: str = ""
    required: bool = False
    default: Any = None
    minimum: float | None = None
    maximum: float | None = None
    choices: list[Any] = []
    read_only: bool = False


def describe_params(cls: type[Params]) -> dict[str, ParamDescription]:
    info = msgspec.inspect.type_info(cls)
    assert isinstance(info, msgspec.inspect.StructType)
    return {field.encode_name: _describe(field) for field in info.fields}


def about_params(cls: type[Params]) -> str:
    """Return what a parameter class says of its parameters, then those that it is made of; "" for nothing."""
    bases = (base for base in cls.__mro__ if issubclass(base, Params) and base is not Params)
    texts = (inspect.cleandoc(base.__dict__.get("__doc__") or "") for base in bases)
    return "\n\n".join(text for text in texts if text)


def _describe(field: msgspec.inspect.Field) -> ParamDescription:
    kind, schema, extra = field.type, dict[str, Any](), dict[str, Any]()
    if isinstance(kind, msgspec.inspect.Metadata):
        schema = kind.extra_json_schema or {}
        extra = kind.extra or {}
        kind = kind.type
    choices = list(kind.values) if isinstance(kind, msgspec.inspect.LiteralType) else []
    if "choices" in extra:
        choices = list(extra["choices"]())
    default = None
    if field.default is not msgspec.NODEFAULT:
        default = msgspec.to_builtins(field.default)
    elif field.default_factory is not msgspec.NODEFAULT:
        default = msgspec.to_builtins(field.default_factory())
    return ParamDescription(
        name=field.encode_name,
        description=schema.get("description", ""),
        type=_type_text(kind),
        unit=schema.get("x-unit", ""),
        required=field.required,
        default=default,
        minimum=getattr(kind, "ge", None),
        maximum=getattr(kind, "le", None),
        choices=choices,
        read_only=bool(extra.get("read_only")),
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


def changed_read_only(
    described: Mapping[str, ParamDescription], before: Mapping[str, Any], changes: Mapping[str, Any]
) -> list[str]:
    return [
        name
        for name, value in changes.items()
        if (known := described.get(name)) and known.read_only and value != before.get(name, known.default)
    ]
