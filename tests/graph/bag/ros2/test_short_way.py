"""What reads and writes ROS 2's bytes the short way makes what the long way makes, or leaves it to that."""

from __future__ import annotations

import struct
from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
import pytest

from palp_core.errors import BagError
from palp_core.graph.bag.ros2.definitions import (
    BYTES,
    FLOATS,
    INTEGERS,
    PACKED,
    Definitions,
    FieldType,
    standard,
)
from palp_core.graph.bag.ros2.short_way import OTHERWISE, quick_reader, quick_writer
from palp_core.graph.bag.ros2.values import _long_reader, _long_writer, reader, writer

DEFINITIONS = standard()
DEFINITIONS.add(
    {
        "lab_msgs/msg/Part": "bool on\nfloat64 value\nstring name\nint16 code",
        "lab_msgs/msg/Whole": "byte one\nuint64[3] three\nlab_msgs/Part[2] two\nstring[2] words\nint8 last\n"
        "lab_msgs/Part[] parts\nbool[] flags\nfloat32[2] pair\nfloat32[] more\nint8 end\nuint8[] raw\n"
        "string[] texts\nchar tail\nfloat64[] long_ones\nint64[] whole_ones\nuint8[4] four\nfloat32 single",
    }
)
WHOLE = "lab_msgs/msg/Whole"


def one(definitions: Definitions, kind: FieldType, random: Random) -> Any:
    """Return a value for a field, as it travels in palp."""
    if kind.many:
        count = kind.length or random.choice((0, 1, 2, 5))
        if kind.base in BYTES:
            return random.randbytes(count)
        if kind.base in PACKED:
            values = [one(definitions, kind.element, random) for _ in range(count)]
            return np.array(values, np.float64).tobytes()
        return [one(definitions, kind.element, random) for _ in range(count)]
    if kind.is_message:
        return made(definitions, kind.base, random)
    if kind.base == "string":
        return random.choice(("", "a", "probe", "größer", "x" * 9))
    if kind.base in FLOATS:
        return struct.unpack("<f", struct.pack("<f", random.uniform(-9, 9)))[0]
    if kind.base == "bool":
        return random.random() < 0.5
    low, high = (0, 127) if kind.base == "byte" else INTEGERS[kind.base]
    return random.choice((low, high, 0, random.randint(low, high)))


def made(definitions: Definitions, name: str, random: Random) -> dict[str, Any]:
    """Return a message of a type."""
    return {f: one(definitions, kind, random) for f, kind in definitions.fields(name).items()}


def test_every_standard_type_has_the_same_bytes_and_the_same_map_either_way() -> None:
    random, quick = Random(1), 0
    for name in DEFINITIONS.names:
        short_write, short_read = quick_writer(DEFINITIONS, name), quick_reader(DEFINITIONS, name)
        if short_write is None or short_read is None:
            continue
        long_write, long_read = _long_writer(DEFINITIONS, name), _long_reader(DEFINITIONS, name)
        for _ in range(3):
            message = made(DEFINITIONS, name, random)
            data = long_write(message)
            assert short_write(message) == data, name
            assert short_read(data) == long_read(data), name
        quick += 1
    assert quick > 0.9 * len(DEFINITIONS.names)


def test_what_is_not_said_is_zero_or_empty_either_way() -> None:
    long_write = _long_writer(DEFINITIONS, WHOLE)
    assert writer(DEFINITIONS, WHOLE)({}) == long_write({})
    some = {"three": [1, 2, 3], "two": [{}, {"name": "b"}], "words": ["", "c"], "parts": [{"value": 2.0}]}
    short_write = quick_writer(DEFINITIONS, WHOLE)
    assert short_write is not None
    assert short_write(some) == long_write(some)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-9],
        lambda data: data + bytes(4),
        lambda data: b"\0\0" + data[2:],
        lambda data: data[:4] + b"\xff" * (len(data) - 4),
        lambda data: data[:2],
    ],
)
def test_bytes_that_are_no_such_message_are_left_to_the_long_way(spoil: Callable[[bytes], bytes]) -> None:
    random, read = Random(2), quick_reader(DEFINITIONS, WHOLE)
    assert read is not None
    data = spoil(writer(DEFINITIONS, WHOLE)(made(DEFINITIONS, WHOLE, random)))
    with pytest.raises(OTHERWISE):
        read(data)
    with pytest.raises(BagError, match=f"no {WHOLE}"):
        reader(DEFINITIONS, WHOLE)(data)


def test_big_endian_bytes_are_read_the_long_way() -> None:
    name = "geometry_msgs/msg/Point"
    data = b"\0\0\0\0" + struct.pack(">ddd", 1.0, 2.0, 3.0)
    assert reader(DEFINITIONS, name)(data) == {"x": 1.0, "y": 2.0, "z": 3.0}


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({"one": 300}, "one: 300 is no byte"),
        ({"two": [{}, {"code": 1 << 20}]}, r"two.code: 1048576 is no int16"),
        ({"parts": [{"name": 5}]}, "parts.name: 5 is no text"),
        ({"pair": b""}, r"pair: float32\[2\] takes 2 values"),
    ],
)
def test_a_value_that_does_not_fit_is_named(message: dict[str, Any], words: str) -> None:
    with pytest.raises(BagError, match=words):
        writer(DEFINITIONS, WHOLE)(message)


def test_whole_numbers_with_a_point_and_lists_for_arrays_go_the_long_way() -> None:
    write = writer(DEFINITIONS, WHOLE)
    assert write({"one": 3.0, "more": [1.0], "raw": [7]}) == write(
        {"one": 3, "more": struct.pack("<d", 1.0), "raw": b"\x07"}
    )


def test_a_byte_is_read_as_it_was_written() -> None:
    name = "std_msgs/msg/Byte"
    assert reader(DEFINITIONS, name)(writer(DEFINITIONS, name)({"data": 200})) == {"data": 200}
