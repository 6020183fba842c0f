"""What viewers may change and how messages reach them: as a bag of JSON has them, and back as they were."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.bag.forms import convert
from palp_core.graph.bag.reader import Bag
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.foxglove.graph_access import MOST_BYTES, GraphAccess, from_json, schema_text, to_json
from palp_core.graph.foxglove.server import ThinnedTopic
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import decode_any, encode_any


class Answering:
    """Stands for the nodes of a graph; notes what was set."""

    def __init__(self, launched: list[dict[str, Any]] | None) -> None:
        self.launched = launched
        self.set: list[dict[str, Any]] = []

    def __call__(self, endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        if request["op"] == "launch":
            return None if self.launched is None else {"nodes": self.launched}
        assert request["op"] == "set_parameters"
        if request["node"] == "stubborn":
            return {"error": "stubborn: no"}
        self.set.append({request["node"]: request["parameters"]})
        return {"parameters": request["parameters"]}


def access(
    answering: Answering, clock: str, *, read_only: bool = False, operate: bool = False
) -> GraphAccess:
    nodes = [NodeEntry(name, "", 0, "", f"ipc:///run/{name}") for name in ("stage", "stubborn")]
    record = RunRecord("rig", "rig.yaml", clock, 0, 0, "ipc:///run/graph", nodes, [])
    return GraphAccess(RunningGraph(record, answering), read_only=read_only, operate=operate)


MOVING, RESTING = [{"name": "stage", "moves": True}], [{"name": "stage", "moves": False}]


@pytest.mark.parametrize(
    ("clock", "launched", "flags", "refused"),
    [
        ("wall", MOVING, {}, "moves something real; start palp bridge foxglove with --operate"),
        ("wall", None, {}, "moves something real"),  # nobody can say
        ("wall", MOVING, {"operate": True}, ""),
        ("wall", RESTING, {}, ""),
        ("sim", MOVING, {}, ""),
        ("sim", MOVING, {"read_only": True}, "started with --read-only"),
        ("wall", RESTING, {"read_only": True}, "started with --read-only"),
    ],
)
def test_what_moves_is_changed_only_where_that_was_said(
    clock: str, launched: list[dict[str, Any]] | None, flags: dict[str, bool], refused: str
) -> None:
    answering = Answering(launched)
    asked = access(answering, clock, **flags)
    if refused:
        with pytest.raises(GraphError, match=f"refused to set a parameter: .*{refused}"):
            asked.set_parameters({"/stage.lift_mm": 6.0})
        assert answering.set == []
    else:
        asked.set_parameters({"/stage.lift_mm": 6.0})
        assert answering.set == [{"stage": {"lift_mm": 6.0}}]
        answering.launched = MOVING  # a node that moves something may come later
        assert bool(asked.refusal()) == (clock == "wall" and not flags)


def test_what_one_node_refuses_is_set_of_the_others() -> None:
    answering = Answering(RESTING)
    wanted = {"/stage.lift_mm": 6.0, "/stubborn.x": 1, "/stage.rate_hz": 1.0, "no name": 2}
    with pytest.raises(GraphError, match=r"/stubborn: no; no node 'no name'"):
        access(answering, "sim").set_parameters(wanted)
    assert answering.set == [{"stage": {"lift_mm": 6.0, "rate_hz": 1.0}}]


@pytest.mark.parametrize(("fastest_hz", "shown"), [(5.0, [1, 100]), (0.0, list(range(1, 101)))])
def test_a_fast_topic_is_thinned_and_its_latest_message_is_shown_when_it_is_due(
    fastest_hz: float, shown: list[int]
) -> None:
    topic = ThinnedTopic(fastest_hz)
    for sequence in range(1, 101):
        topic.take(pack(b"/a/b", Kind.DATA, 0, sequence, 0, 0), sequence * 1_000_000)
        topic.take(pack(b"/a/b", Kind.HEARTBEAT, 0, sequence, 0, 0), sequence * 1_000_000)
    found = topic.due(150_000_000) + topic.due(201_000_000)
    assert [frame.sequence for frame in found] == shown
    topic.take(pack(b"/a/b", Kind.DATA, 0, 50, 0, 0), 900_000_000)  # of a publisher that has moved on
    assert topic.due(1_100_000_000) == []


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
    with pytest.raises(SchemaMismatch, match="does not fit its schema"):
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
