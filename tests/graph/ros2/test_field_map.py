"""What becomes of a message by a map: fields, units, times, lists, and blocks that become samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.graph.bag.ros2.definitions import standard
from palp_core.graph.bag.ros2.values import reader, writer
from palp_core.graph.messages.schema_reader import JsonSchema
from palp_core.graph.problems import Problems
from palp_core.graph.ros2.crossing import crossing_to_palp, crossing_to_ros2
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.map_file import read_map

ARRAY = {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8"}
BLOCK: JsonSchema = {
    "title": "Block",
    "type": "object",
    "properties": {
        "stamp_ns": {"type": "integer"},
        "rate_hz": {"type": "number"},
        "torque_n_m": ARRAY,
        "names": {"type": "array", "items": {"type": "string"}},
    },
}
MESSAGE: dict[str, Any] = {
    "stamp_ns": 2_000_000_005,
    "rate_hz": 500.0,
    "torque_n_m": np.array([0.5, -0.25]).tobytes(),
    "names": ["a", "b"],
}
LATER = Times(lambda ns: ns + 10_000_000_000, lambda ns: ns - 10_000_000_000)


def to_ros2(text: str, tmp_path: Path) -> list[tuple[int, dict[str, Any]]]:
    """What MESSAGE becomes, through ROS 2's bytes and back."""
    crossing = _crossing(f"to_ros2:\n  - {{palp: /a/b, ros: /x, {text}}}\n", tmp_path)
    definitions = standard()
    way = crossing.convert(MESSAGE, 7)
    encode, decode = writer(definitions, crossing.type), reader(definitions, crossing.type)
    return [(at_ns, decode(encode(value))) for at_ns, value in way]


def _crossing(text: str, tmp_path: Path) -> Any:
    file, problems = tmp_path / "map.yaml", Problems()
    file.write_text(text, encoding="utf-8")
    described = read_map(file, problems)
    make, ways = (crossing_to_ros2, described.to_ros2)
    if described.to_palp:
        make, ways = crossing_to_palp, described.to_palp
    found = make(ways[0], BLOCK, standard(), [], LATER, problems)
    problems.raise_any()
    return found


def test_a_wrench_of_the_last_sample_has_the_time_of_ros_2(tmp_path: Path) -> None:
    text = (
        "type: geometry_msgs/msg/WrenchStamped, fields: {wrench.torque.z: 'torque_n_m[-1]', "
        "header.stamp: stamp_ns, header.frame_id: {value: probe}, "
        "wrench.force.x: {from: rate_hz, times: 0.001, plus: 1}}"
    )
    ((_, wrench),) = to_ros2(text, tmp_path)
    assert wrench["header"] == {"stamp": {"sec": 12, "nanosec": 5}, "frame_id": "probe"}
    assert wrench["wrench"]["torque"] == {"x": 0.0, "y": 0.0, "z": -0.25}
    assert wrench["wrench"]["force"]["x"] == pytest.approx(1.5)


def test_a_block_becomes_a_message_a_sample_each_with_its_time(tmp_path: Path) -> None:
    text = (
        "type: sensor_msgs/msg/JointState, each: {over: torque_n_m, start: stamp_ns, rate: rate_hz}, "
        "fields: {header.stamp: $stamp, name: {value: [joint]}, effort: [torque_n_m]}"
    )
    found = to_ros2(text, tmp_path)
    assert [at_ns for at_ns, _ in found] == [2_000_000_005, 2_002_000_005]
    assert [np.frombuffer(m["effort"]).tolist() for _, m in found] == [[0.5], [-0.25]]
    assert [m["header"]["stamp"]["nanosec"] for _, m in found] == [5, 2_000_005]
    assert {tuple(m["name"]) for _, m in found} == {("joint",)}


def test_messages_in_lists_are_made_field_by_field(tmp_path: Path) -> None:
    text = (
        "type: tf2_msgs/msg/TFMessage, fields: {transforms: [{child_frame_id: {value: tip}, "
        "transform.translation.x: 'torque_n_m[0]', transform.rotation: {w: 1.0}}]}"
    )
    ((at_ns, tf),) = to_ros2(text, tmp_path)
    (one,) = tf["transforms"]
    assert (at_ns, one["child_frame_id"], one["transform"]["translation"]["x"]) == (7, "tip", 0.5)
    assert one["transform"]["rotation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def test_elements_by_number_and_whole_lists_go_over(tmp_path: Path) -> None:
    text = (
        "type: sensor_msgs/msg/JointState, fields: {name: names, 'position[0]': rate_hz, "
        "'position[1]': 2.0, velocity: torque_n_m, effort: {from: torque_n_m, times: 1000.0}}"
    )
    ((_, found),) = to_ros2(text, tmp_path)
    assert found["name"] == ["a", "b"]
    arrays = [np.frombuffer(found[field]).tolist() for field in ("position", "velocity", "effort")]
    assert arrays == [[500.0, 2.0], [0.5, -0.25], [500.0, -250.0]]


def test_without_a_type_it_is_palps_own(tmp_path: Path) -> None:
    crossing = _crossing("to_ros2: [{palp: /a/b, ros: /x}]", tmp_path)
    assert crossing.type == "palp_msgs/msg/Block"
    assert list(crossing.convert(MESSAGE, 7)) == [(7, MESSAGE)]


def test_what_comes_from_ros_2_has_the_graphs_time_and_form(tmp_path: Path) -> None:
    crossing = _crossing(
        "to_palp:\n  - ros: /x\n    palp: /a/b\n    type: sensor_msgs/msg/JointState\n"
        "    fields: {stamp_ns: header.stamp, names: name, torque_n_m: effort, rate_hz: 'position[0]'}",
        tmp_path,
    )
    effort, position = np.array([1.5]).tobytes(), np.array([4.0]).tobytes()
    header = {"stamp": {"sec": 11, "nanosec": 3}, "frame_id": ""}
    message = {"header": header, "name": ["j"], "effort": effort, "position": position, "velocity": b""}
    assert list(crossing.convert(message, 7)) == [
        (7, {"stamp_ns": 1_000_000_003, "names": ["j"], "torque_n_m": effort, "rate_hz": 4.0})
    ]
