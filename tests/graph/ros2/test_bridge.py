"""The bridge between a running graph and nodes of ROS 2's own, over Fast DDS on this host's loopback."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.hosts import Host, joining, own_host, trusting
from tests.support.palp import PATIENCE_S, ROOT, Palp

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        importlib.util.find_spec("rclpy") is None, reason="needs rclpy: pip install --editable '.[dev,ros2]'"
    ),
]

GRAPH = ROOT / "examples/interop/launch/interop.yaml"
MAP = ROOT / "examples/interop/ros2_map.py"


def own_domain() -> dict[str, str]:
    """Return the surroundings of ROS 2 on this host only, in a domain that no other test's worker has."""
    domain = 1 + zlib.crc32(os.environ.get("PYTEST_XDIST_WORKER", str(os.getpid())).encode()) % 100
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.fixture
def beside(palp: Palp) -> Palp:
    """The command line beside ROS 2."""
    palp.environment |= own_domain()
    return palp


@pytest.fixture
def home() -> Iterator[Host]:
    """A host of a graph beside ROS 2."""
    with own_host() as host:
        host.environment |= own_domain()
        yield host


@pytest.fixture
def away(home: Host) -> Iterator[Host]:
    with own_host() as host:
        trusting(home, host)
        yield host


def peer(palp: Palp, *arguments: str) -> Any:
    """Run a node of ROS 2's own; return what it has found."""
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("peer.py"), *arguments],
        env=palp.environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def launched(palp: Palp, file: object) -> subprocess.Popen[str]:
    graph = palp.start("launch", file)
    while not list(palp.runtime_dir.glob("palp/*/graph.json")):
        assert graph.poll() is None, graph.communicate()
    return graph


def bridged(palp: Palp, file: Path, *words: str) -> subprocess.Popen[str]:
    """Start a bridge; return it when it says that it has begun, with these words."""
    bridge = palp.start("bridge", "ros2", file)
    assert bridge.stdout is not None
    begun = bridge.stdout.readline()
    assert all(word in begun for word in words), (begun, bridge.communicate())
    return bridge


def ended(bridge: subprocess.Popen[str]) -> tuple[str, str]:
    bridge.send_signal(signal.SIGINT)
    out, err = bridge.communicate(timeout=PATIENCE_S)
    assert bridge.returncode == 130
    return out, err


def test_all_that_a_map_names_crosses_and_nothing_is_lost(beside: Palp) -> None:
    graph = launched(beside, GRAPH)
    bridge = bridged(beside, MAP, "as /interop_bridge (2 topics to ROS 2, 1 topic from ROS 2")
    told = peer(beside, "all")
    assert 0.0 <= told.pop("age_s") < 5.0
    assert told["topics"]["/torque_samples"] == told.pop("topics")["/load"] == ["std_msgs/msg/Float64"]
    refused = told.pop("refused")
    assert refused[0] is False
    assert "must be a number of at least 0.001" in refused[1]
    assert told == {
        "frame": "probe", "tare": [True, "tared at 12.5 N m"], "listed": ["block_hz"],
        "described": "float Hz", "set": [True, ""], "got": 25.0,
    }  # fmt: skip
    out, err = ended(bridge)
    assert err == ""
    assert "/load -> /sensor/load: 100 crossed, 0 lost" in out
    assert "/tare calls /sensor/tare: 1 crossed, 0 lost" in out
    assert out.count(", 0 lost") == 4
    assert graph.poll() is None


def test_the_bridges_death_harms_neither_side_and_another_goes_on(beside: Palp) -> None:
    graph, bridge = launched(beside, GRAPH), bridged(beside, MAP)
    bridge.kill()
    bridge.wait(PATIENCE_S)
    again = beside.start("bridge", "ros2", MAP)
    assert peer(beside, "all")["got"] == 25.0
    assert graph.poll() is None
    graph.terminate()
    out, err = again.communicate(timeout=PATIENCE_S)
    assert again.returncode == 0, err
    assert "graph 'interop' has ended" in err
    assert "/load -> /sensor/load: 100 crossed" in out


def test_a_type_that_is_not_installed_is_left_out(beside: Palp, tmp_path: Path) -> None:
    folder = tmp_path / "own_msgs/msg"
    folder.mkdir(parents=True)
    (folder / "Own.msg").write_text("float64 data\n", encoding="utf-8")
    own = f'Own = message_type("own_msgs/msg/Own", "{tmp_path}")'
    text = MAP.read_text(encoding="utf-8").replace("Float64 = message_type", f"{own}\nFloat64 = message_type")
    file = tmp_path / "own_map.py"
    file.write_text(text.replace('"/torque_samples", Float64', '"/torque_samples", Own'), encoding="utf-8")
    (tmp_path / "msgs").symlink_to(ROOT / "examples/interop/msgs")
    launched(beside, GRAPH)
    bridge = beside.start("bridge", "ros2", file)
    assert peer(beside, "all")["got"] == 25.0
    out, err = ended(bridge)
    assert "/torque_samples: own_msgs/msg/Own is not installed for Python, left out; build own_msgs" in err
    assert "/torque_samples" not in out


JOIN_MAP = """
from typing import Any

from nodes.toys import Tick
from palp_core.graph.ros2.maps import share_parameters, to_ros2
from palp_core.graph.ros2.message_types import message_type

Int64 = message_type("std_msgs/msg/Int64")


@to_ros2("/ticker/tick", "/at_home", Int64)
def tick(message: Tick) -> Any:
    return Int64(data=message.index)


@to_ros2("/guest/tick", "/away", Int64)
def guest(message: Tick) -> Any:
    return Int64(data=message.index)


parameters = share_parameters()
"""
TICKER = ["count", "rate_hz", "size"]


def test_what_a_map_says_of_a_node_that_has_joined_crosses(home: Host, away: Host) -> None:
    file = home.folder / "tick_map.py"
    file.write_text(JOIN_MAP, encoding="utf-8")
    graph = home.launch()
    guest = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "guest"))
    graph.until_printed("/guest has joined")
    bridge = bridged(home, file, "as /home_bridge (2 topics to ROS 2")
    assert peer(home, "hear", "/at_home", "ticker") == TICKER
    assert peer(home, "hear", "/away", "guest") == TICKER
    out, err = ended(bridge)
    assert err == ""
    assert "/guest/tick -> /away: " in out
    assert out.count(", 0 lost") == 2
    assert guest.poll() is None
    graph.end()


ASKS_NODES = '''
from palp_core import Message, Node, Params, Pub, Qos, State, Sub, every, on


class Ask(Message):
    wanted: bool


class Rate(Params):
    rate_hz: float = 10.0


class Answer(Message):
    success: bool
    message: str


class Asked(State):
    answered: bool = False


class First(Node):
    """Ask for a switch until it is answered, and say once what the answer was."""

    params: Rate
    state: Asked
    ask = Pub(Ask)
    answer = Sub(Answer)
    told = Pub(Answer, qos=Qos(durability="transient_local", depth=1))

    @every("rate_hz")
    def again(self):
        if not self.state.answered:
            self.ask.publish(Ask(wanted=True))

    @on(answer)
    def take(self, answer):
        if not self.state.answered:
            self.state.answered = True
            name = type(self).__name__
            self.told.publish(Answer(success=answer.success, message=name + " " + answer.message))


class Second(First):
    """Take its place, and ask anew."""

    def on_resume(self):
        self.state.answered = False
'''
ASKS_LAUNCH = """\
graph: asks
clock: wall
nodes:
  asker: {run: "nodes.asks:First", inputs: {answer: {external: true}}}
"""
ASKS_MAP = """
from collections.abc import Generator
from typing import Any

from nodes.asks import Answer, Ask
from palp_core.graph.ros2.maps import Times, call_ros2, to_ros2
from palp_core.graph.ros2.message_types import message_type

String = message_type("std_msgs/msg/String")


@to_ros2("/asker/told", "/told", String)
def told(answer: Answer) -> Any:
    return String(data=answer.message)


@call_ros2("/asker/ask", "/switch", "std_srvs/srv/SetBool", to="/asker/answer")
def switch(ask: Ask, request: Any, times: Times) -> Generator[Any, Any, Answer]:
    request.data = ask.wanted
    response = yield request
    return Answer(success=response.success, message=response.message)
"""


def test_a_topic_asks_ros_2_and_what_is_latched_reaches_those_who_come_late_across_a_swap(
    home: Host,
) -> None:
    for name, text in (
        ("nodes/asks.py", ASKS_NODES), ("launch/asks.yaml", ASKS_LAUNCH), ("asks_map.py", ASKS_MAP),
    ):  # fmt: skip
        (home.folder / name).write_text(text, encoding="utf-8")
    graph = launched(home, "launch/asks.yaml")
    bridge = bridged(home, home.folder / "asks_map.py", "(1 topic to ROS 2, 1 call)")
    assert peer(home, "serve", "First") == "First switched"
    swap = home.start("swap", "asker", "nodes.asks:Second")
    assert swap.wait(PATIENCE_S) == 0, swap.communicate()
    assert peer(home, "serve", "Second") == "Second switched"
    out, err = ended(bridge)
    assert "/asker/told -> /told: 2 crossed, 0 lost" in out
    assert "no node of ROS 2 serves /switch" in err
    assert graph.poll() is None
