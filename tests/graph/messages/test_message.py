"""Messages: what they may hold, what their bytes are, what is refused."""

import enum
import types
from typing import Annotated, Any, Literal

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from msgspec import Meta
from numpy.typing import NDArray

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.schema import _within, schema_of
from palp_core.graph.messages.schema_reader import ros_text
from palp_core.units import Count, Metres, MetresArray, NewtonMetres, Newtons, ProbabilityArray


class Point(Message):
    """A place."""

    x_m: Metres
    y_m: Metres = 0.0


class Everything(Message):
    """One field of each kind.

    Only the first line of this is the description.
    """

    flag: bool
    count: Count
    integer: int
    ratio: float
    text: str
    blob: bytes
    depth_m: MetresArray
    weights: ProbabilityArray
    numbers: list[int]
    reals: list[float]
    words: list[str]
    flags: list[bool]
    forces_n: list[Newtons]
    place: Point
    path: list[Point]


def _array(low: float, high: float) -> st.SearchStrategy[NDArray[np.float64]]:
    return hnp.arrays(np.float64, st.integers(0, 5), elements=st.floats(low, high))


class Route(Message):
    places_m: list[Metres]


class Weights(Message):
    weights: ProbabilityArray


class Holder(Message):
    one: Weights
    many: list[Weights] = []


points = st.builds(Point, x_m=st.floats(-1e3, 1e3), y_m=st.integers(-1000, 1000))
everything = st.builds(
    Everything,
    flag=st.booleans(),
    count=st.integers(0, 2**63 - 1),
    integer=st.integers(-(2**63), 2**63 - 1),
    ratio=st.floats() | st.integers(-(2**53), 2**53),
    text=st.text(max_size=8),
    blob=st.binary(max_size=8),
    depth_m=_array(-1e3, 1e3),
    weights=_array(0.0, 1.0),
    numbers=st.lists(st.integers(-(2**63), 2**63 - 1), max_size=4),
    reals=st.lists(st.floats(), max_size=4),
    words=st.lists(st.text(max_size=4), max_size=3),
    flags=st.lists(st.booleans(), max_size=3),
    forces_n=st.lists(st.floats(-1e4, 1e4) | st.integers(-5, 5), max_size=3),
    place=points,
    path=st.lists(points, max_size=3),
)


@given(everything)
def test_a_decoded_message_equals_the_one_that_was_encoded(message: Everything) -> None:
    decoded = decode(Everything, encode(message))
    assert decoded == message
    assert not decoded != message  # noqa: SIM202 - the other operator
    assert hash(decoded) == hash(message)
    assert encode(decoded) == encode(message)


@settings(max_examples=50)
@given(everything)
def test_any_msgpack_library_reads_a_message(message: Everything) -> None:
    plain = msgpack.unpackb(encode(message))
    assert list(plain) == list(Everything.__struct_fields__)
    assert plain["path"] == [{"x_m": p.x_m, "y_m": p.y_m} for p in message.path]
    assert plain["words"] == message.words
    assert plain["integer"] == message.integer
    np.testing.assert_array_equal(np.frombuffer(plain["depth_m"], "<f8"), message.depth_m)


@given(everything, st.data())
def test_damaged_bytes_raise_schema_mismatch_and_nothing_else(message: Everything, data: Any) -> None:
    whole = encode(message)
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
    for _ in range(data.draw(st.integers(0, 3))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        decode(Everything, bytes(damaged))
    except SchemaMismatch:
        pass
    else:
        assert len(damaged) == len(whole)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1000.1, -1000.1])
def test_a_bounded_number_refuses_nan_infinity_and_what_is_out_of_bounds(value: float) -> None:
    with pytest.raises(SchemaMismatch, match="x_m must be a number of at"):
        decode(Point, encode(Point(x_m=value)))
    with pytest.raises(SchemaMismatch):
        decode(Route, encode(Route(places_m=[0.0, value])))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1.1, -0.1])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_bounded_array_refuses_nan_infinity_and_what_is_out_of_bounds(value: float, place: int) -> None:
    array = np.full(3, 0.5)
    array[place] = value
    bad, good = Weights(weights=array), Weights(weights=np.full(3, 0.5))
    for message in (bad, Holder(one=bad), Holder(one=good, many=[good, bad])):
        with pytest.raises(SchemaMismatch, match=r"Weights\.weights"):
            decode(type(message), encode(message))
    assert decode(Holder, encode(Holder(one=good, many=[good]))).one == good


class Block(Message):
    a: MetresArray
    s: str = ""


@settings(max_examples=30)
@given(st.integers(0, 9), st.integers(0, 300))
def test_a_decoded_array_is_aligned_read_only_and_one_dimensional(padding: int, size: int) -> None:
    data = encode(Block(a=np.arange(size, dtype=float) / 300, s="x" * padding))
    array = decode(Block, data).a
    assert array.ndim == 1
    assert array.dtype == np.float64
    assert array.flags.aligned
    assert array.ctypes.data % 8 == 0
    assert not array.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        array[:1] = 0.0


@pytest.mark.parametrize(
    "array",
    [
        np.arange(10.0)[::2],
        np.arange(5.0)[::-1],
        np.arange(6.0).reshape(2, 3)[:, 1],
        np.arange(5.0).astype(">f8"),
        np.arange(5, dtype=np.int32),
        np.arange(5, dtype=np.float32),
        np.frombuffer(b"x" + np.arange(3.0).tobytes(), np.uint8)[1:].view("<f8"),
        np.zeros(0),
        np.zeros(0, dtype=np.float32)[::-1],
    ],
)
def test_whatever_an_array_looks_like_in_memory_its_values_travel(array: NDArray[Any]) -> None:
    np.testing.assert_array_equal(decode(Block, encode(Block(a=array))).a, array)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((2, 2)),
        np.zeros(2, dtype=complex),
        np.array(["a"]),
        np.array([object()]),
        np.array(["2020-01-01"], dtype="M8[s]"),
    ],
)
def test_an_array_that_would_lose_its_shape_or_meaning_is_refused(array: Any) -> None:
    with pytest.raises(SchemaMismatch, match="cannot travel"):
        encode(Block(a=array))


@pytest.mark.parametrize("payload", [b"1234567", [1.0, 2.0], "12345678", 1.0, None])
def test_an_array_is_bin_of_whole_float64_and_nothing_else(payload: Any) -> None:
    with pytest.raises(SchemaMismatch):
        decode(Block, msgpack.packb({"a": payload}))


def _make(name: str = "Sample", doc: str = "", **fields: Any) -> Any:
    namespace = {"__annotations__": fields, "__module__": __name__, "__doc__": doc}
    return types.new_class(name, (Message,), exec_body=lambda body: body.update(namespace))


class Colour(enum.Enum):
    RED = "red"


@pytest.mark.parametrize(
    "annotation",
    [
        int | None,
        int | str,
        dict[str, int],
        tuple[int, int],
        set[int],
        list[list[int]],
        list[MetresArray],
        list[bytes],
        Literal["a"],
        Colour,
        Any,
        object,
    ],
)
def test_what_a_ros_message_cannot_say_is_refused(annotation: Any) -> None:
    with pytest.raises(SchemaMismatch, match=r"Bad\.field"):
        schema_of(_make("Bad", field=annotation))


class Tree(Message):
    children: list["Tree"] = []


def test_a_message_that_contains_itself_is_refused_each_time() -> None:
    for _ in range(2):
        with pytest.raises(SchemaMismatch, match="contains itself"):
            schema_of(Tree)


def test_messages_are_frozen_and_keyword_only() -> None:
    point = Point(x_m=1.0)
    with pytest.raises(AttributeError):
        point.x_m = 2.0
    with pytest.raises(TypeError):
        Point(1.0)  # type: ignore[call-arg]


def test_messages_are_equal_when_their_bytes_are() -> None:
    assert Point(x_m=1.0) == Point(x_m=1)
    assert Point(x_m=float("nan")) == Point(x_m=float("nan"))
    assert Point(x_m=1.0) != Point(x_m=2.0)
    assert len({Point(x_m=0.0), Point(x_m=0), Point(x_m=1.0)}) == 2


def test_numpy_scalars_travel_as_plain_numbers() -> None:
    half, two = np.float32(0.5), np.int64(2)
    message = Point(x_m=half, y_m=two)  # type: ignore[arg-type]
    assert msgpack.unpackb(encode(message)) == {"x_m": 0.5, "y_m": 2.0}
    assert decode(Point, encode(message)) == message


def test_an_int_in_a_float_field_has_the_bytes_of_the_float() -> None:
    class Mixed(Message):
        value: float
        values: list[float]
        point: Point

    assert encode(Mixed(value=1, values=[1, 2.5], point=Point(x_m=3))) == encode(
        Mixed(value=1.0, values=[1.0, 2.5], point=Point(x_m=3.0))
    )
    with pytest.raises(SchemaMismatch):
        decode(Point, encode(Point(x_m=True)))


def test_what_cannot_travel_is_refused_when_encoded() -> None:
    class Text(Message):
        s: str

    with pytest.raises(SchemaMismatch, match="object cannot travel"):
        encode(Text(s=object()))  # type: ignore[arg-type]


def test_a_reader_of_an_older_type_ignores_new_fields_and_fills_missing_ones() -> None:
    assert decode(Point, msgpack.packb({"x_m": 1.0, "new": [1, 2]})) == Point(x_m=1.0)
    with pytest.raises(SchemaMismatch, match="x_m"):
        decode(Point, b"\x80")


def _hash(*arguments: Any, **fields: Any) -> int:
    return schema_of(_make(*arguments, **fields)).type_hash


def test_the_type_hash_changes_with_name_type_and_unit_only() -> None:
    base = _hash(a=Metres, b=int)
    assert base == _hash("Sample", "Another text.", a=Metres, b=int)
    assert base == _hash(a=Annotated[float, Meta(ge=0, extra_json_schema={"x-unit": "m"})], b=Count)
    others = [
        _hash("Other", a=Metres, b=int),
        _hash(a=NewtonMetres, b=int),
        _hash(a=float, b=int),
        _hash(c=Metres, b=int),
        _hash(b=int, a=Metres),
        _hash(a=Metres, b=str),
        _hash(a=Metres),
        _hash(a=MetresArray, b=int),
        _hash(a=list[Metres], b=int),
        _hash(a=_make("Inner", x=Metres), b=int),
        _hash(a=_make("Inner", x=Newtons), b=int),
        _hash(a=list[_make("Inner", x=Metres)], b=int),  # type: ignore[misc]
    ]
    assert len({base, *others}) == len(others) + 1


def test_the_json_schema_is_one_object_without_references() -> None:
    schema = schema_of(Everything).json_schema
    assert schema["type"] == "object"
    assert schema["title"] == "Everything"
    assert schema["description"] == "One field of each kind."
    assert schema["required"] == list(Everything.__struct_fields__)
    assert "$ref" not in str(schema)
    fields = schema["properties"]
    packed = {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8"}
    assert fields["depth_m"] == {**packed, "x-unit": "m"}
    assert fields["blob"] == {"type": "string", "contentEncoding": "base64"}
    assert fields["numbers"] == {"type": "array", "items": {"type": "integer"}}
    assert fields["reals"] == {"type": "array", "items": {"type": "number"}}
    assert fields["forces_n"] == {"type": "array", "items": {"type": "number", "x-unit": "N"}}
    assert fields["flags"] == {"type": "array", "items": {"type": "boolean"}}
    assert fields["place"]["properties"]["x_m"] == {"type": "number", "x-unit": "m"}
    assert fields["path"] == {"type": "array", "items": fields["place"]}


def test_the_ros_text_names_every_field_with_its_unit() -> None:
    assert ros_text(schema_of(Point).json_schema) == "float64 x_m  # m\nfloat64 y_m  # m\n"
    lines = ros_text(schema_of(Everything).json_schema).splitlines()
    assert "float64[] depth_m  # m" in lines
    assert "uint8[] blob" in lines
    assert "Point place" in lines
    assert "Point[] path" in lines
    assert "float64[] forces_n  # N" in lines


any_float = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(-1.0, 1.0),
    st.sampled_from([1.0, -1.0, 1e200, 1e-170, 1e-190]),
)


@given(
    st.lists(any_float, max_size=40),
    st.sampled_from(
        [
            (-1.0, 1.0),
            (0.0, 1.0),
            (-1e3, 0.5),
            (0.2, 0.9),
            (-np.inf, np.inf),
            (-1e300, 1e300),
            (-1e-180, 1e-180),
        ]
    ),
)
def test_an_array_is_within_bounds_exactly_if_each_element_is(
    values: list[float], bounds: tuple[float, float]
) -> None:
    low, high = bounds
    assert _within(np.array(values), low, high) == all(low <= value <= high for value in values)
