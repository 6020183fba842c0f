"""The arithmetic and the rules of joining, without any process."""

from __future__ import annotations

import hashlib
import json
import socket
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from palp_core.errors import GraphError, SchemaMismatch, SecurityError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import TopicInfo, resolved_yaml
from palp_core.graph.description.node_class import NodeClassRequest, inspect_classes
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.messages.qos import Qos
from palp_core.graph.network.address import host_and_port, plan_listening
from palp_core.graph.network.bridge import OffsetEstimate
from palp_core.graph.network.curve import Received
from palp_core.graph.network.gateway import BURST, MOST_KINDS, PERIOD_NS, Gateway, RejectedPeers
from palp_core.graph.network.gateway_handle import view_of
from palp_core.graph.network.join_protocol import (
    PROTOCOL,
    FromGateway,
    GatewayEvent,
    GraphView,
    HealthReport,
    Join,
    JoinHello,
    JoinMessage,
    JoinRequest,
    ListenOn,
    ToGateway,
    decode_message,
)
from palp_core.graph.network.joining import join_request, objections, wired_spec
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.node.spec import RESERVED_NAMES, name_mistake
from palp_core.graph.problems import GraphProblems
from palp_core.graph.process.channel import MessageChannel
from tests.support.fake_graph import health_of
from tests.support.hosts import LAUNCH, TOYS
from tests.support.rig_session import check_here

NS = st.integers(0, 10**9)
MESSAGES = (7, "0079b08275e57850")


def without_prose(schema: Any) -> Any:
    if isinstance(schema, dict):
        return {name: without_prose(part) for name, part in schema.items() if name != "description"}
    return [without_prose(part) for part in schema] if isinstance(schema, list) else schema


def test_other_messages_are_another_version_of_joining() -> None:
    """PROTOCOL grows with a change of the messages, unless hosts before and after understand each other."""
    schemas = without_prose(list(msgspec.json.schema_components(JoinMessage.__subclasses__())))
    digest = hashlib.sha256(json.dumps(schemas, sort_keys=True).encode()).hexdigest()
    assert (PROTOCOL, digest[:16]) == MESSAGES
    wire = Path(__file__).resolve().parents[3] / "docs" / "reference" / "wire.md"
    assert f'{{"op": "hello", "protocol": {PROTOCOL}}}' in wire.read_text(encoding="utf-8")


@given(st.integers(-(10**15), 10**15), st.lists(st.tuples(NS, NS, NS), min_size=1, max_size=40))
def test_the_clocks_offset_is_within_its_uncertainty_whatever_the_ways_take(
    offset_ns: int, ways: list[tuple[int, int, int]]
) -> None:
    estimate = OffsetEstimate()
    for at_ns, there_ns, back_ns in ways:
        estimate.add(at_ns, at_ns + there_ns + offset_ns, at_ns + there_ns + back_ns)
    best = estimate.best()
    assert abs(best.offset_ns - offset_ns) <= best.uncertainty_ns + 1
    shortest_ns = min(there_ns + back_ns for _, there_ns, back_ns in ways[-32:])
    assert best.uncertainty_ns == (shortest_ns + 1) // 2


def info(node: str, port: str, type_hash: str = "0" * 16, qos: Qos | None = None) -> TopicInfo:
    return TopicInfo(
        node=node,
        port=port,
        type="Sample",
        type_hash=type_hash,
        ros_text="",
        json_schema={},
        qos=qos or Qos(),
    )


VIEW = GraphView(
    graph="rig",
    clock="wall",
    nodes=["torque"],
    topics={
        "/torque/block": info("torque", "block"),
        "/torque/truth": info("torque", "truth"),
        "/torque/lossy": info("torque", "lossy", qos=Qos(reliability="best_effort")),
    },
)


@pytest.mark.parametrize(
    ("topic", "changes", "words"),
    [
        ("/torque/block", {}, ""),
        ("/torque/truth", {"reads_truth": True}, ""),
        ("/torque/truth", {}, "simulates or records"),
        ("/torque/blokc", {}, "did you mean '/torque/block'"),
        ("/torque/lossy", {}, "the publisher offers best_effort"),
        ("/torque/block", {"type_hash": "1" * 16}, "update the older host"),
        *(
            ("/torque/block", {"name": name}, name_mistake(name))
            for name in (*sorted(RESERVED_NAMES), "../x", "", "1x", "x" * 33)
        ),
        ("/torque/block", {"name": "torque"}, "a node 'torque' is in graph 'rig' already"),
    ],
)
def test_the_launch_files_rules_hold_for_who_comes_later(
    topic: str, changes: dict[str, Any], words: str
) -> None:
    node, port = topic.removeprefix("/").split("/")
    wanted = info(node, port, changes.pop("type_hash", "0" * 16))
    request = JoinRequest(
        **{"name": "viewer", "run": "a:B", "host": "h", "pid": 1, "inputs": {"sample": wanted}, **changes}
    )
    found = "; ".join(objections(request, VIEW, {"torque"}))
    assert words in found
    assert bool(found) == bool(words)


EXPECTED = '  metronome: {run: "guest_toys:Ticker", joined: true}\n'


@pytest.fixture(scope="session")
def toys(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, GraphView]:
    """Their folder and a graph that expects a metronome; a process imports the module once, so makes one."""
    folder = tmp_path_factory.mktemp("toys")
    (folder / "guest_toys.py").write_text(TOYS, encoding="utf-8")
    file = folder / "home.yaml"
    file.write_text(LAUNCH.replace("nodes.toys", "guest_toys") + EXPECTED, encoding="utf-8")
    return folder, view_of(check_here(file))


@pytest.mark.parametrize(
    ("name", "run", "wires", "words"),
    [
        ("guest", "Keeper", {"tick": "/ticker/tikc"}, "did you mean '/ticker/tick'"),
        ("guest", "Keeper", {"tick": "/keeper/received"}, "/keeper/received carries Tock, not Tick"),
        ("guest", "Keeper", {}, "add -r tick:=/ticker/tick or -r tick:=/keeper/tick or -r tick:=/metr"),
        ("guest", "Keeper", {"tock": "/ticker/tick"}, "has no port 'tock'"),
        ("guest", "Ticker", {"tick": "/keeper/tick"}, "is no input: only inputs can be wired from outside"),
        ("guest", "Ticker", {"reset": "/keeper/tick"}, "is no input: only inputs can be wired from outside"),
        ("metronome", "Keeper", {"tick": "/ticker/tick"}, "lacks output 'tick', which the launch file"),
        ("ticker", "Ticker", {}, "a node 'ticker' is in graph 'home' already"),
        ("metronome", "Ticker", {}, ""),
        ("guest", "Keeper", {"tick": "ticker/tick"}, ""),
    ],
)
def test_wires_that_do_not_fit_the_running_graph_are_refused_with_the_reason(
    toys: tuple[Path, GraphView], name: str, run: str, wires: dict[str, str], words: str
) -> None:
    folder, view = toys
    (described,) = inspect_classes([NodeClassRequest(f"guest_toys:{run}", name=name)], folder)
    try:
        spec = wired_spec(name, described.run, {}, wires, described, view)
        said = "; ".join(objections(join_request(spec, described), view, view.nodes))
    except GraphError as refused:
        said = str(refused)
    assert (words in said) if words else not said, said


def test_a_launch_file_expects_somebody_on_the_wall_clock_only(toys: tuple[Path, GraphView]) -> None:
    file = toys[0] / "home.yaml"
    assert "joined: true" in resolved_yaml(check_here(file))
    sim = toys[0] / "sim.yaml"
    sim.write_text(file.read_text(encoding="utf-8").replace("clock: wall", "clock: sim"), encoding="utf-8")
    with pytest.raises(GraphProblems, match="that takes clock: wall"):
        check_here(sim)


@example(b"\x81\xa1x" * 100_000)
@given(st.binary(max_size=200))
def test_no_bytes_do_harm_to_who_reads_a_word(raw: bytes) -> None:
    try:
        decode_message(raw)
    except SchemaMismatch:
        return
    assert isinstance(msgspec.msgpack.decode(raw), dict)


def test_a_guest_says_of_itself_alone_how_it_does_and_not_too_often(tmp_path: Path) -> None:
    torque = encode(health_of("torque", pid=77))
    ours, theirs = socket.socketpair()
    launcher = MessageChannel(ours, msgspec.msgpack.Decoder(FromGateway))
    gateway = Gateway(
        MessageChannel(theirs, msgspec.msgpack.Decoder(ToGateway)),
        ListenOn(run_dir=str(tmp_path), endpoint="tcp://127.0.0.1:0", secured=False, view=VIEW),
        KeyFolder(tmp_path / "keys"),
    )
    words = [
        JoinHello(),
        HealthReport(health=torque),  # of nobody who has joined
        Join(request=JoinRequest(name="guest", run="x:Y", host="h", pid=1)),
        HealthReport(health=b"no health"),
        HealthReport(health=bytes(1 << 20)),
        *[HealthReport(health=torque) for _ in range(1000)],
    ]
    for word in words:
        gateway._on_received(Received(b"connection", "", "127.0.0.1", msgspec.msgpack.encode(word)))
    gateway._report("last", "", "")
    sent = list(iter(launcher.receive, GatewayEvent(kind="last", node="", text="")))
    events = [message.kind for message in sent if isinstance(message, GatewayEvent)]
    assert events == ["listening", "joined"]
    reports = [message for message in sent if isinstance(message, HealthReport)]
    does = decode(NodeHealth, reports[0].health)
    assert (reports[0].node, does.node, does.pid) == ("guest", "guest", 0)
    assert 0 < does.counted_ns <= monotonic_ns()  # it has not said when it counted
    assert 0 < len(reports) < 1000
    gateway.event_loop.close()
    for channel in (launcher, gateway._channel):
        channel.close()


@pytest.mark.parametrize(
    "address", ["127.0.0.1:5", "tcp://:5", "tcp://h", "tcp://h:99999", "udp://h:5", "tcp://h:x"]
)
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(SecurityError, match="write tcp://HOST:PORT"):
        host_and_port(address)


@pytest.mark.parametrize("address", ["tcp://0.0.0.0:5", "tcp://*:5", "tcp://[::]:5", "tcp://192.0.2.1:5"])
def test_beyond_loopback_there_must_be_keys(tmp_path: Path, address: str) -> None:
    keys = KeyFolder(tmp_path / "keys")
    with pytest.raises(SecurityError, match="refusing to listen"):
        plan_listening(address, keys)
    keys.generate("rig")
    planned = plan_listening(address, keys)
    assert planned.secured
    assert "no host is allowed" in planned.warnings[0]
    local = plan_listening("tcp://localhost:5", KeyFolder(tmp_path / "none"))
    assert not local.secured
    assert "without keys" in local.warnings[0]


@settings(max_examples=50)
@given(st.integers(1, 2000), st.integers(1, 100), st.booleans())
def test_strangers_take_bounded_memory_and_lines_and_one_that_insists_is_told_at_powers_of_two(
    count: int, seconds: int, insists: bool
) -> None:
    strangers = RejectedPeers()
    step_ns = PERIOD_NS if insists else seconds * PERIOD_NS // count
    told = [
        strangers.add("10.0.0.1" if insists else str(k), "", "why", PERIOD_NS + k * step_ns) is not None
        for k in range(count)
    ]
    assert len(strangers.kinds) == (1 if insists else min(count, MOST_KINDS))
    assert sum(told) <= BURST + seconds
    if insists:
        assert [k for k, is_told in enumerate(told, 1) if is_told] == [
            2**n for n in range(count.bit_length())
        ]
        assert f"({count} times)" in str(strangers.kinds["10.0.0.1", "", "why"]) or count == 1
