"""A quantity is a number with its unit and its bounds, palp's own or one that somebody makes in a line."""

from __future__ import annotations

import math
from typing import Annotated, get_args

import msgspec
import numpy as np
import pytest

from palp_core import units
from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.schema import schema_of
from palp_core.units import Celsius, Float64Array, NewtonsArray, SecondsArray, Volts, array_of, quantity

Moles = Annotated[float, quantity("mol", 0.0, 1e3)]
MolesArray = Annotated[Float64Array, array_of("mol", 0.0, 1e3)]


class Warm(Message):
    body: Celsius
    sensor: Volts
    grip: NewtonsArray
    at: SecondsArray
    salt: Moles
    salts: MolesArray


def warm(**changed: object) -> Warm:
    given: dict[str, object] = {"body": 36.6, "sensor": -0.2, "grip": np.array([1.0, -2.0]), "salt": 0.1}
    given |= {"at": np.array([0.0, 0.5]), "salts": np.array([0.5])}
    return Warm(**{**given, **changed})  # type: ignore[arg-type]


def test_quantities_of_ones_own_have_units_and_bounds_as_palps_have() -> None:
    fields = schema_of(Warm).json_schema["properties"]
    assert {name: field["x-unit"] for name, field in fields.items()} == {
        "body": "degC", "sensor": "V", "grip": "N", "at": "s", "salt": "mol", "salts": "mol",
    }  # fmt: skip
    assert decode(Warm, encode(warm())) == warm()


@pytest.mark.parametrize(
    "changed",
    [
        {"body": -274.0},
        {"sensor": math.nan},
        {"salt": -1.0},
        {"grip": np.array([0.0, math.inf])},
        {"at": np.array([-1.0])},
        {"salts": np.array([2e3])},
    ],
)
def test_what_lies_beyond_its_bounds_is_refused(changed: dict[str, object]) -> None:
    with pytest.raises(SchemaMismatch):
        decode(Warm, encode(warm(**changed)))


def test_every_array_has_the_unit_and_bounds_of_its_quantity() -> None:
    def told(alias: object) -> tuple[object, ...]:
        kind, meta = get_args(alias)
        assert isinstance(meta, msgspec.Meta)
        extra = meta.extra or {}
        low, high = (meta.ge, meta.le) if kind is float else extra["bounds"]
        return (meta.extra_json_schema or {})["x-unit"], low, high

    arrays = [
        name for name in vars(units) if name.endswith("Array") and name not in ("Float64Array", "NDArray")
    ]
    assert len(arrays) > 10
    for name in arrays:
        alone = getattr(units, name.removesuffix("Array"))
        assert told(getattr(units, name)) == told(alone), name
