"""Messages as viewers get them: what a bag of JSON has, and what a person types comes back as it was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.bag.forms import convert
from palp_core.graph.bag.reader import Bag
from palp_core.graph.foxglove.graph_access import MOST_BYTES, from_json, schema_text, to_json
from palp_core.graph.messages.message import decode_any, encode_any

GOLDEN = Path(__file__).parents[2] / "golden" / "sweep.mcap"
SCHEMA: dict[str, Any] = {
    "title": "Everything",
    "type": "object",
    "properties": {
        "index": {"type": "integer"},
        "torque_n_m": {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8", "x-unit": "N m"},
        "blob": {"type": "string", "contentEncoding": "base64"},
        "poses": {
            "type": "array",
            "items": {"title": "Pose", "type": "object", "properties": {"x_m": {"type": "number"}}},
        },
    },
}


def test_viewers_get_what_a_bag_of_json_has(tmp_path: Path) -> None:
    convert(GOLDEN, tmp_path / "json", "json")
    with Bag(GOLDEN) as bag, Bag(tmp_path / "json") as converted:
        for (stream, *_, payload), (other, *_, text) in zip(
            bag.recorded(), converted.recorded(), strict=True
        ):
            schema = stream.topic.json_schema
            assert to_json(schema)(payload) == text
            assert json.loads(schema_text(schema)) == other.topic.json_schema


def test_what_json_cannot_say_is_null() -> None:
    payload = encode_any(
        {"index": 1, "poses": [{"x_m": float("nan")}], "torque_n_m": b"", "blob": b"\x00\xff"}
    )
    assert json.loads(to_json(SCHEMA)(payload)) == {
        "index": 1, "torque_n_m": [], "blob": "AP8=", "poses": [{"x_m": None}],
    }  # fmt: skip


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x01", encode_any({"index": "x"})])
def test_a_payload_that_is_no_such_message_is_refused(payload: bytes) -> None:
    with pytest.raises(SchemaMismatch, match="not what its schema says"):
        to_json(SCHEMA)(payload)


def test_a_schema_of_another_tool_is_shown_as_it_comes() -> None:
    convert_any = to_json({"type": "object", "properties": {"odd": {"type": ["null", "string"]}}})
    assert json.loads(convert_any(encode_any({"odd": None, "more": [1]}))) == {"odd": None, "more": [1]}


def test_what_is_typed_travels_as_the_node_wants_it() -> None:
    text = json.dumps({"index": 3, "torque_n_m": [0.5, 1], "poses": [{"x_m": 2}]}).encode()
    message = from_json(text, SCHEMA)
    assert decode_any(dict, encode_any(message)) == {
        "index": 3, "torque_n_m": b"\0\0\0\0\0\0\xe0?\0\0\0\0\0\0\xf0?", "poses": [{"x_m": 2.0}],
    }  # fmt: skip
    assert from_json(b"", SCHEMA) == {}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"{", "no Everything: "),
        (b"[]", "expected a mapping"),
        (b'{"index": 1.5}', "index: expected an integer"),
        (b'{"indx": 1}', "indx: no such field.* 'index'"),
        (b'{"torque_n_m": "x"}', "torque_n_m: expected a list"),
        (b'{"index": "\xff"}', "no Everything: "),
        (b"[" * 100_000, "no Everything: "),
        (b'"' + b"x" * MOST_BYTES + b'"', "are more than"),
    ],
)
def test_a_mistake_is_said_with_its_field(text: bytes, why: str) -> None:
    with pytest.raises(GraphError, match=why):
        from_json(text, SCHEMA)
