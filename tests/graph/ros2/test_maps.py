"""Maps are Python modules: what their functions let cross, and every mistake with its place and a fix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from palp_core.cli import bridge as command
from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.bag.forms import writing
from palp_core.graph.bag.ros2.export_bag import write
from palp_core.graph.bag.ros2.values import reader, writer
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.message import Message, encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import topic_of
from palp_core.graph.ros2.maps import Entry, Times, as_message, as_plain, read_map
from palp_core.graph.ros2.message_types import known_types, message_type
from palp_core.graph.ros2.parameters import _ros_value
from palp_core.graph.ros2.plan import outlets_of
from tests.support.palp import ROOT, Palp

HEAD = '''\
"""A map."""

from collections.abc import Generator, Iterator
from typing import Any

from palp_core import Message
from palp_core.graph.ros2.maps import Times, call_ros2, from_ros2, serve_ros2, share_parameters, to_ros2
from palp_core.graph.ros2.message_types import message_type
from palp_core.units import Nanoseconds, NewtonMetresArray

Float64 = message_type("std_msgs/msg/Float64")
WrenchStamped = message_type("geometry_msgs/msg/WrenchStamped")


class Block(Message):
    stamp_ns: Nanoseconds
    torque_n_m: NewtonMetresArray


class Load(Message):
    torque_n_m: float


class Tare(Message):
    pass


'''
AT = HEAD.count("\n") + 1
SENDS = """\
@to_ros2("/sensor/block", "/torque", WrenchStamped, depth=7)
def wrench(block: Block, times: Times) -> Any:
    message = WrenchStamped()
    message.header.stamp = times.to_ros2(block.stamp_ns)
    message.wrench.torque.x = block.torque_n_m[-1]
    return message


@to_ros2("/sensor/block", "/samples", Float64)
def samples(block: Block, times: Times) -> Iterator[tuple[int, Any]]:
    for index, value in enumerate(block.torque_n_m):
        yield block.stamp_ns + index, Float64(data=value)
"""
CHANGES = """\
@from_ros2("/load", "/sensor/load", WrenchStamped)
def load(message: Any, times: Times) -> Load:
    return Load(torque_n_m=message.wrench.torque.x + times.to_palp(message.header.stamp))


@serve_ros2("/sensor/tare", "/tare", "std_srvs/srv/Trigger")
def tare(request: Any, response: Any) -> Generator[Tare, Load, Any]:
    reply = yield Tare()
    response.message = f"{reply.torque_n_m}"
    return response


@call_ros2("/sensor/block", "/switch", "std_srvs/srv/SetBool", to="/sensor/load")
def switch(block: Block, request: Any, times: Times) -> Generator[Any, Any, Load]:
    response = yield request
    return Load(torque_n_m=float(response.success))


parameters = share_parameters("sensor")
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "lab_map.py"
    file.write_text(HEAD + text, encoding="utf-8")
    return file


def read(folder: Path, text: str = SENDS + CHANGES) -> dict[str, Entry]:
    return {entry.kind + entry.ros: entry for entry in read_map(str(written(folder, text)))}


def test_functions_convert_between_the_messages_of_both_sides(tmp_path: Path) -> None:
    found = read(tmp_path)
    assert [entry.name for entry in found.values()] == [
        "/sensor/block -> /torque", "/sensor/block -> /samples", "/load -> /sensor/load",
        "/tare calls /sensor/tare", "/sensor/block calls /switch", " -> /sensor",
    ]  # fmt: skip
    block = found["to_ros2/torque"].messages[0]
    payload = encode(block(stamp_ns=2_000_000_005, torque_n_m=np.array([0.25, 0.5])))
    times = Times(2_000_000_010, offset_ns=10**12)
    ((at_ns, wrench),) = found["to_ros2/torque"].to_ros2(payload, times)
    data = writer(known_types(), "geometry_msgs/msg/WrenchStamped")(wrench)
    plain = reader(known_types(), "geometry_msgs/msg/WrenchStamped")(data)
    assert (at_ns, plain["header"]["stamp"]) == (times.stamp_ns, {"sec": 1002, "nanosec": 5})
    assert plain["wrench"]["torque"] == {"x": 0.5, "y": 0.0, "z": 0.0}
    assert [(at, one.data) for at, one in found["to_ros2/samples"].to_ros2(payload, times)] == [
        (2_000_000_005, 0.25), (2_000_000_006, 0.5),
    ]  # fmt: skip
    load = found["from_ros2/load"].convert(wrench, times)
    assert as_plain(load) == {"torque_n_m": 0.5 + 2_000_000_005}
    with pytest.raises(SchemaMismatch):
        as_message(block, {"stamp_ns": "now"})


def test_a_type_of_ones_own_is_found_in_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Outer.msg").write_text("Inner[2] inner\ngeometry_msgs/Point at\nuint8[] raw\nstring[] from\n")
    (folder / "Inner.msg").write_text("float32 x\n")
    made = message_type("own_msgs/msg/Outer", tmp_path)()
    assert ([one.x for one in made.inner], made.at.z, len(made.raw), made.from_) == ([0.0, 0.0], 0.0, 0, [])


@pytest.mark.parametrize("values", [[1, 2], np.array([1, 2]), np.array([1, 2], np.float32)])
def test_arrays_of_any_numbers_have_the_types_of_their_fields(values: Any) -> None:
    kind = "std_msgs/msg/Float64MultiArray"
    plain = reader(known_types(), kind)(writer(known_types(), kind)(message_type(kind)(data=values)))
    assert np.frombuffer(plain["data"]).tolist() == [1.0, 2.0]


SERVE = '@serve_ros2("/a/b", "/x", "std_srvs/srv/Trigger")\n'
SEND = '@to_ros2("/a/b", "/x", Float64)\n'


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("gone_lab.maps", None, "No module named 'gone_lab'"),
        ("gone.py", None, "gone.py; check the path"),
        ("", None, "the map has no decorated function; add one with @to_ros2 or @from_ros2"),
        ("1 / 0", AT, "ZeroDivisionError: division by zero"),
        ("import gone_lab", AT, "ModuleNotFoundError: No module named 'gone_lab'"),
        ("raise SystemExit(0)", AT, "SystemExit: 0"),
        ('message_type("geometry_msgs/msg/Wrenches")', AT, "no message type 'geometry_msgs/msg/Wrenches'"),
        (SEND + "def f(block, times): ...", AT, "f: parameter 'block' is not a message of the graph"),
        (SEND + "def f(): ...", AT, "f: parameter '' is not a message of the graph"),
        (SEND.replace("/a/b", "a") + "def f(b: Load, t): ...", AT, "f: 'a' is not a name; write /node/port"),
        (SEND.replace("/x", "x") + "def f(b: Load, t): ...", AT, "f: 'x' is not a name; write a name from"),
        (SEND.replace("64)", "64, depth=0)") + "def f(b: Load, t): ...", AT, "depth = 0"),
        (SEND.replace("64)", "64, dept=1)") + "def f(b: Load, t): ...", AT, "'dept'"),
        ('@from_ros2("/x", "/a/b", Float64)\ndef f(m, t): ...', AT, "f: what it returns is not a message"),
        (SERVE.replace("std_srvs/srv/", "") + "def f(): ...", AT, "f: 'Trigger' is not a name; write PACK"),
        (
            f"{SERVE}def f(q, r, t) -> Load: ...",
            AT, "f: not a generator; annotate it with Generator[YIELDED, SENT, RETURNED]",
        ),
        (
            f"{SERVE}def f(q, r, t) -> Generator[int, Load, Any]: yield",
            AT, "f: what it yields is not a message of the graph",
        ),
        (
            f"{SEND}def f(b: Load, t): ...\n{SEND}def g(b: Load, t): ...",
            AT + 2, f"/a/b -> /x is at {{file}}:{AT}:1 already; remove one of both",
        ),
        (
            f'{SEND}def f(b: Load, t): ...\n@from_ros2("/x", "/a/c", Float64)\ndef g(m, t) -> Load: ...',
            AT + 2, "this map publishes /x, too; rename one of both",
        ),
    ],
)  # fmt: skip
def test_every_mistake_has_its_place_and_a_fix(
    tmp_path: Path, text: str, line: int | None, expected: str
) -> None:
    file = written(tmp_path, text)
    with pytest.raises(GraphError) as caught:
        read_map(text if text.startswith("gone") else str(file))
    assert expected.format(file=file) in str(caught.value)
    assert line is None or str(caught.value).startswith(f"{file}:{line}:")


def test_the_documented_map_is_the_examples_and_has_no_mistake(palp: Palp) -> None:
    file = ROOT / "examples/interop/ros2_map.py"
    page, example = (ROOT / "docs/how_to/ros2.md").read_text("utf-8"), file.read_text("utf-8")
    for part in page.split("```python\n")[2].partition("```")[0].split("\n\n\n"):
        assert part.strip() in example
    checked = palp.run("bridge", "ros2", file, "--check")
    assert (checked.returncode, checked.stderr) == (0, "")
    assert checked.stdout.endswith("no mistake by itself; no graph runs to check it against\n")


def test_a_function_that_raises_leaves_no_half_bag(tmp_path: Path) -> None:
    file = written(tmp_path, SENDS)
    block = read_map(str(file))[0].messages[0]
    with BagWriter(tmp_path / "bag") as bag:
        stream = bag.stream(Stream(topic=topic_of("/sensor/block", block)))
        for index, values in enumerate(([1.0], []), 1):
            bag.write(stream, index, 0, index, encode(block(stamp_ns=index, torque_n_m=np.array(values))))
    with (
        pytest.raises(GraphError, match=f"lab_map.py:{AT}:1: IndexError: "),
        writing(tmp_path / "ros") as folder,
    ):
        write(tmp_path / "bag", folder, outlets_of(str(file), tmp_path / "bag"), known_types())
    assert not (tmp_path / "ros").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("/sensor/block", "/sensor/blok", "no topic '/sensor/blok' is in .*; did you mean '/sensor/block'"),
        ("block: Block", "block: Load", "lab_map.py:[0-9]+:1: /sensor/block: its messages are no Load"),
    ],
)
def test_a_map_is_checked_against_a_bag(tmp_path: Path, old: str, new: str, words: str) -> None:
    block = read_map(str(written(tmp_path, SENDS)))[0].messages[0]
    with BagWriter(tmp_path / "bag") as bag:
        bag.stream(Stream(topic=topic_of("/sensor/block", block)))
    with pytest.raises(GraphError, match=words):
        outlets_of(str(written(tmp_path, SENDS.replace(old, new))), tmp_path / "bag")


class Running:
    """A graph with the node ``sensor``, which answers for itself."""

    def __init__(self, types: dict[str, type[Message]], *, moves: bool = False) -> None:
        hashes = {name: {"type_hash": schema_of(kind).hash_text} for name, kind in types.items()}
        self._replies: dict[str, dict[str, Any]] = {
            "info": {"external": ["load"], "services": {"tare": ["Tare", "Load"]}},
            "schemas": {
                "ports": {"load": {"types": [hashes["Load"]]}, "tare": {"types": list(hashes.values())[1:]}}
            },
            "launch": {"nodes": [{"name": "sensor", "moves": moves}]},
        }
        nodes, topic = (
            [NodeEntry("sensor", "", 0, "", "ipc:///run/sensor")],
            topic_of("/sensor/block", types["Block"]),
        )
        self.graph = RunningGraph(
            RunRecord("lab", "lab.yaml", "wall", 0, 0, "ipc:///run/graph", nodes, [topic]), self._ask
        )

    def _ask(self, _endpoint: str, request: dict[str, Any], _timeout_s: float) -> dict[str, Any]:
        return self._replies[request["op"]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run the command beside a graph whose messages are those of the map."""

    def running(text: str, *, moves: bool = False, **options: Any) -> None:
        classes = {kind.__name__: kind for entry in read(tmp_path).values() for kind in entry.messages}
        types = {name: classes[name] for name in ("Block", "Tare", "Load")}
        graph = Running(types, moves=moves).graph
        monkeypatch.setattr(command, "find_graph", lambda *_, **__: graph)
        command.ros2(str(written(tmp_path, text)), graph="lab", **options)

    return running


@pytest.mark.parametrize(
    ("text", "old", "new", "expected"),
    [
        (SENDS, "/sensor/block", "/sensor/blok", "{AT}:1: no topic '/sensor/blok' in graph 'lab'; did you"),
        (SENDS, "block: Block", "block: Load", "{AT}:1: /sensor/block: its messages are no Load of lab_map"),
        (CHANGES, "/sensor/load", "/sensor/lod", "no port '/sensor/lod' takes messages from outside; did"),
        (CHANGES, "-> Load:", "-> Tare:", "/sensor/load: its messages are no Tare of lab_map"),
        (CHANGES, "/sensor/tare", "/sensor/tar", "no service '/sensor/tar' in the graph; did you mean"),
        (CHANGES, "Tare, Load", "Load, Load", "/sensor/tare: its messages are no Load of lab_map"),
        (CHANGES, '("sensor")', '("senor")', "no node 'senor' in graph 'lab'; did you mean '/sensor'?"),
    ],
)
def test_a_map_is_checked_beside_the_graph(run: Any, text: str, old: str, new: str, expected: str) -> None:
    with pytest.raises(GraphError) as caught:
        run(text.replace(old, new), check=True)
    assert expected.format(AT=AT) in str(caught.value)


def test_a_map_is_checked_without_rclpy(run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    run(SENDS + CHANGES, check=True)
    assert "lab_map.py: no mistake, checked against graph 'lab'" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "moves", "options", "refused"),
    [
        *((part, True, {}, "moves something real.*add --operate") for part in CHANGES.split("\n\n\n")),
        (CHANGES, True, {"operate": True}, "begun"),
        (CHANGES, False, {}, "begun"),
        (SENDS, True, {}, "begun"),
        (CHANGES.split("\n\n\n")[2].replace(', to="/sensor/load"', ""), True, {}, "begun"),
    ],
)
def test_ros_2_changes_what_moves_only_with_permission(
    run: Any, monkeypatch: pytest.MonkeyPatch, text: str, moves: bool, options: dict[str, bool], refused: str
) -> None:
    def begin() -> None:
        raise typer.BadParameter("begun")

    monkeypatch.setattr("palp_core.graph.ros2.middleware.require", begin)
    with pytest.raises((GraphError, typer.BadParameter), match=refused):
        run(text, moves=moves, **options)


@pytest.mark.parametrize(
    ("value", "field", "expected"),
    [
        (None, "type", 0),
        (True, "bool_value", True),
        (3, "integer_value", 3),
        (2.5, "double_value", 2.5),
        ("a", "string_value", "a"),
        ([1, 2.5], "double_array_value", [1.0, 2.5]),
        ([1, 2], "integer_array_value", [1, 2]),
        (["a"], "string_array_value", ["a"]),
        ({"a": 1}, "string_value", '{"a": 1}'),
        ([{"a": 1}], "string_value", '[{"a": 1}]'),
    ],
)
def test_a_parameter_has_ros_2s_type_or_is_json(value: Any, field: str, expected: Any) -> None:
    pytest.importorskip("rclpy", exc_type=ImportError)
    found = getattr(_ros_value(value), field)
    assert (list(found) if isinstance(expected, list) else found) == expected
