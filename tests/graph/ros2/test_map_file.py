"""A map file is read as a launch file is: every mistake with its place and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.bag.ros2.definitions import json_schema, standard
from palp_core.graph.messages.schema_reader import JsonSchema
from palp_core.graph.problems import GraphProblems, Problems
from palp_core.graph.ros2.crossing import crossing_to_palp, crossing_to_ros2, find_definitions
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.map_file import MapFile, read_map
from palp_core.graph.ros2.plan import check_alone

BLOCK: JsonSchema = {
    "title": "Block",
    "type": "object",
    "properties": {
        "stamp_ns": {"type": "integer"},
        "start_ns": {"type": "integer"},
        "rate_hz": {"type": "number"},
        "phase": {"type": "string"},
        "torque_n_m": {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8"},
    },
}
HEAD = "to_ros2:\n  - {palp: /torque/block, ros: /torque, type: geometry_msgs/msg/WrenchStamped, "


def mistakes(text: str, tmp_path: Path) -> list[str]:
    """All that is wrong with a map, on its own and beside a topic of blocks; places without the file."""
    file = tmp_path / "map.yaml"
    file.write_text(text, encoding="utf-8")
    problems = Problems()
    try:
        described = read_map(file, problems)
    except GraphProblems as error:
        return [str(problem).removeprefix(f"{file}:") for problem in error.problems]
    check_alone(described, problems)
    if not len(problems):
        _plan(described, problems)
    return [str(problem).removeprefix(f"{file}:") for problem in problems.listed()]


def _plan(described: MapFile, problems: Problems) -> None:
    for plan, ways in ((crossing_to_ros2, described.to_ros2), (crossing_to_palp, described.to_palp)):
        for way in ways:
            plan(way, BLOCK, standard(), described.interfaces, Times(), problems)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[]", "1:1: a map must be a mapping with some of the keys to_ros2"),
        ("{}", "1:1: nothing crosses; add to_ros2"),
        ("to_ros: []", "1:1: a map has no key 'to_ros'; did you mean 'to_ros2'?"),
        ("to_ros2: {}", "1:10: to_ros2 must be a list; write [{palp: /node/port, ros: /name}]"),
        ("to_ros2: [3]", "1:11: an entry of to_ros2 must be a mapping with palp and ros"),
        ("to_ros2:\n  - {palp: /a/b}", "2:5: an entry of to_ros2 lacks ros; add ros: /name"),
        ("to_ros2:\n  - {palp: a, ros: /x}", "2:12: palp is 'a'; write /node/port"),
        ("to_ros2:\n  - {palp: /a/b, ros: x}", "2:23: ros is 'x'; write a name from the root, as in /torque"),
        (
            "to_ros2:\n  - {palp: /a/b, ros: /x, type: Wrench}",
            "2:33: type is 'Wrench'; write PACKAGE/msg/NAME",
        ),
        (
            "to_ros2:\n  - {palp: /a/b, ros: /x, type: geometry_msgs/msg/Wrenches}",
            "2:33: no message type 'geometry_msgs/msg/Wrenches' is known; did you mean 'geometry_msgs",
        ),
        (
            "services:\n  - {palp: /a/b, ros: /x, type: lab_srvs/srv/None}",
            "2:33: no service type 'lab_srvs/srv/None' is known: no lab_srvs/srv/None.srv is in the folders",
        ),
        (
            "services:\n  - {palp: /a/b, ros: /x}",
            "2:5: an entry of services lacks type; add type: std_srvs/srv",
        ),
        ("parameters: 3", "1:13: parameters must be a list of nodes, or all"),
        ("clock: 3", "1:8: external of clock is '3'; it must be true or false"),
        ("node: a b", "1:7: node is 'a b'; a name has letters, digits and _"),
        (
            HEAD + "qos: {reliabilty: reliable}}",
            "2:86: qos has no key 'reliabilty'; did you mean 'reliability'?",
        ),
        (HEAD + "qos: {depth: 0}}", "2:93: depth of qos is '0'; it must be a whole number from 1"),
        (HEAD + "fields: {wrench.torqe.x: rate_hz}}", "2:89: 'wrench.torqe.x': Wrench has no field 'torqe'"),
        (HEAD + "fields: {wrench.torque.x: rate}}", "2:106: 'rate': Block has no field 'rate'; did you mean"),
        (HEAD + "fields: {wrench.torque.x: torque_n_m}}", "2:106: 'wrench.torque.x' cannot be 'torque_n_m'"),
        (
            HEAD + "fields: {header.stamp: rate_hz}}",
            "2:103: 'header.stamp' cannot be 'rate_hz': a number is no time",
        ),
        (HEAD + "fields: {header.frame_id: probe}}", "a text that stands for itself is {value: probe}"),
        (HEAD + "fields: {header.frame_id: 3}}", "2:106: header.frame_id: expected a text, got 3"),
        (HEAD + "fields: {wrench.torque.x: {from: phase, times: 2}}}", "'phase' is a text; only numbers are"),
        (HEAD + "fields: {wrench.torque.x: {from: rate_hz, times: a}}}", "times of 'wrench.torque.x' is 'a'"),
        (
            HEAD + "fields: {wrench.torque.x: {times: 2}}}",
            "does not say where it comes from; write {from: field",
        ),
        (HEAD + "fields: {wrench: {}, wrench.torque.x: 1.0}}", "a part of this is given above"),
        (HEAD + "each: torque}", "2:86: each: Block has no field 'torque'; did you mean 'torque_n_m'?"),
        (HEAD + "each: phase}", "2:86: each: 'phase' is a text, not several"),
        (HEAD + "each: {over: torque_n_m, start: start_ns}}", "2:86: each has either start or rate"),
        (HEAD + "each: {over: torque_n_m, start: start_ns, rate: phase}}", "each: 'phase' is no number"),
        (
            "to_ros2:\n  - {palp: /a/b, ros: /x, type: std_msgs/msg/String}",
            "have no field in common; say what",
        ),
        (
            "to_ros2: [{palp: /a/b, ros: /x}]\nto_palp: [{palp: /a/c, ros: /x}]",
            "2:11: /x is sent by this map, too: it would hear itself; rename one",
        ),
    ],
)
def test_every_mistake_has_its_place_and_a_hint(text: str, expected: str, tmp_path: Path) -> None:
    found = mistakes(text, tmp_path)
    assert any(expected in line for line in found), found


def test_standard_services_are_known_where_no_ros_2_is_installed(tmp_path: Path) -> None:
    kinds = ("Empty", "SetBool", "Trigger")
    ways = [f"  - {{palp: /a/b, ros: /{kind}, type: std_srvs/srv/{kind}}}" for kind in kinds]
    assert mistakes("\n".join(["services:", *ways]), tmp_path) == []


def test_the_types_of_ones_own_are_read_from_their_folder(tmp_path: Path) -> None:
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Outer.msg").write_text("Inner[] inner\ngeometry_msgs/Point at\n")
    (folder / "Inner.msg").write_text("float32 x\n")
    definitions = standard()
    find_definitions(definitions, "lab_msgs/msg/Outer", [tmp_path])
    found = json_schema(definitions, "lab_msgs/msg/Outer")["properties"]
    assert found["inner"]["items"]["properties"] == {"x": {"type": "number"}}
    assert list(found["at"]["properties"]) == ["x", "y", "z"]
