"""From YAML to what travels: every mistake names its field, and what passes decodes as the message."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core import Message
from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.discovery.message_yaml import message_from_yaml, packed, parse_yaml
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.messages.message_text import (
    Truncation,
    csv_line,
    decoded,
    parse_path,
    pick,
    readable,
    truncated,
)
from palp_core.graph.messages.schema import schema_of
from palp_core.units import Count, Metres, NewtonMetresArray


class Pose(Message):
    """Where."""

    x_m: Metres
    frame: str = "world"


class Everything(Message):
    """One of each kind."""

    index: Count
    settled: bool
    name: str
    blob: bytes
    torque_n_m: NewtonMetresArray
    codes: list[int]
    pose: Pose
    poses: list[Pose]


SCHEMA = schema_of(Everything).json_schema
WHOLE = """
index: 3
settled: true
name: on
blob: 00ff
torque_n_m: [1, 2.5, 1e-3]
codes: [1, 2]
pose: {x_m: 1}
poses: [{x_m: 0.5, frame: probe}]
"""
PARSED = parse_yaml(WHOLE, "message")


def sent(text: str) -> Everything:
    return decode(Everything, msgspec.msgpack.encode(message_from_yaml(text, SCHEMA, "message")))


def test_every_kind_of_field_can_be_typed() -> None:
    message = sent(WHOLE)
    assert message == Everything(
        index=3,
        settled=True,
        name="on",
        blob=b"\x00\xff",
        torque_n_m=np.array([1.0, 2.5, 1e-3]),
        codes=[1, 2],
        pose=Pose(x_m=1.0),
        poses=[Pose(x_m=0.5, frame="probe")],
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{index: 1.5}", "index: expected an integer, got 1.5"),
        ("{index: true}", "index: expected an integer, got True"),
        ("{index: 99999999999999999999}", "message:1:9: '9*' cannot be read: .* at most 64 bits"),
        (f"{{index: {2**63}}}", f"index: {2**63} does not fit into 64 bits"),
        ("{settled: 1}", "settled: expected true or false, got 1"),
        ("{name: 5}", "name: expected a text, got 5"),
        ("{blob: xyz}", "blob: expected bytes as hexadecimal text"),
        ("{torque_n_m: 1.0}", r"torque_n_m: expected a list of numbers, as in \[1.0, 2.0\], got 1.0"),
        ("{torque_n_m: [1.0, a]}", r"torque_n_m\[1\]: expected a number, got 'a'"),
        ("{codes: [1, a]}", r"codes\[1\]: expected an integer, got 'a'"),
        ("{pose: {x_m: far}}", "pose.x_m: expected a number, got 'far'"),
        ("{poses: [{x_m: 0}, {y_m: 0}]}", r"poses\[1\].y_m: no such field; did you mean 'x_m'"),
        ("{pose: 5}", "pose: expected a mapping"),
        ("{indx: 5}", "indx: no such field; did you mean 'index'?"),
        ("[1]", "the message: expected a mapping"),
        ("{index: 1, index: 2}", "key 'index' is given twice"),
        ("{index: ", "not valid YAML"),
        ("{torque_n_m: [1" + "0" * 400 + "]}", "at most 64 bits"),
    ],
)
def test_a_mistake_is_said_with_its_field(text: str, said: str) -> None:
    with pytest.raises(GraphError, match=said):
        message_from_yaml(text, SCHEMA, "message")


VALUES: st.SearchStrategy[Any] = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([2**63, 2**64])
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from([*SCHEMA["properties"], "x_m", "else"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.sampled_from([*SCHEMA["properties"], "else"]), VALUES)
def test_whatever_a_field_is_given_is_packed_as_it_is_shown_or_refused_by_its_name(
    name: str, value: Any
) -> None:
    message = PARSED | {name: value}

    def packed_twice() -> str:
        payload = msgspec.msgpack.encode(packed(message, SCHEMA, ""))
        assert msgspec.msgpack.encode(packed(decoded(payload, SCHEMA), SCHEMA, "")) == payload
        return name

    assert refusal_of(packed_twice).startswith(name)


def refusal_of(call: Callable[[], str]) -> str:
    """Return what a call says, or the words that refuse it."""
    try:
        return call()
    except SchemaMismatch as refused:
        return str(refused)


def test_a_message_is_shown_as_it_can_be_typed() -> None:
    message = decoded(encode(sent(WHOLE)), SCHEMA)
    assert message["torque_n_m"] == [1.0, 2.5, 1e-3]
    assert message["blob"] == "00ff"
    assert message["poses"] == [{"x_m": 0.5, "frame": "probe"}]
    assert message_from_yaml(msgspec.json.encode(message).decode(), SCHEMA, "again")


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x01", b"\x81", b"\x91" * 5000])
def test_a_payload_that_is_no_message_is_an_error_with_words(payload: bytes) -> None:
    with pytest.raises(GraphError, match="Everything that is no"):
        decoded(payload, SCHEMA)


def test_bytes_that_are_not_whole_floats_are_shown_as_bytes() -> None:
    assert readable(b"\x01\x02", {"x-dtype": "<f8"}) == "0102"


def test_paths_lead_to_fields_and_elements() -> None:
    message = decoded(encode(sent(WHOLE)), SCHEMA)
    assert pick(message, parse_path("pose.x_m", SCHEMA)) == 1.0
    assert pick(message, parse_path("poses[0].frame", SCHEMA)) == "probe"
    assert pick(message, parse_path("torque_n_m[-1]", SCHEMA)) == 1e-3
    with pytest.raises(GraphError, match="no element 9: the array has 3"):
        pick(message, parse_path("torque_n_m[9]", SCHEMA))


@pytest.mark.parametrize(
    "text", ["", ".", "pose.", "a b", "[0", "pose..x_m", "index[0]", "psoe", "pose.y_m", "[0]"]
)
def test_a_path_that_leads_nowhere_is_refused(text: str) -> None:
    with pytest.raises(GraphError):
        parse_path(text, SCHEMA)


def test_long_parts_are_left_out_and_said_to_be() -> None:
    message = {"a": [1, 2, 3], "b": {"c": "abcdef"}}
    assert truncated(message, Truncation(2)) == {"a": [1, 2, "... 1 more"], "b": {"c": "ab..."}}
    assert truncated(message, Truncation(None)) == message
    assert truncated(message, Truncation(0, arrays=False, texts=False)) == {
        "a": "<array of 3>",
        "b": {"c": "<string length: 6>"},
    }


def test_a_line_of_values_quotes_what_needs_it() -> None:
    assert csv_line({"a": [1, 2.5], "b": {"c": "x, y"}, "d": True}) == '1,2.5,"x, y",True'
