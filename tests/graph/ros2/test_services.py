"""Services of ROS 2 that a topic of the graph asks and what is latched, under a running bridge."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from tests.graph.ros2.own_domain import NEEDS_RCLPY, own_domain, run_node
from tests.support.hosts import Host, own_host
from tests.support.palp import PATIENCE_S

pytestmark = NEEDS_RCLPY

NODES = '''
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
LAUNCH = """\
graph: asks
clock: wall
nodes:
  asker: {run: "nodes.asks:First", inputs: {answer: {external: true}}}
"""
MAP = """
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


@pytest.fixture
def home() -> Iterator[Host]:
    with own_host() as host:
        host.environment |= own_domain()
        for name, text in (("nodes/asks.py", NODES), ("launch/asks.yaml", LAUNCH), ("asks_map.py", MAP)):
            (host.folder / name).write_text(text, encoding="utf-8")
        yield host


def answered(host: Host, who: str) -> None:
    """Have ROS 2 serve the switch until who asked says so, to a reader that came late."""
    assert run_node("serves.py", host.environment, who) == f"{who} switched\n"


def test_a_topic_asks_ros_2_and_what_is_latched_reaches_those_who_come_late_across_a_swap(
    home: Host,
) -> None:
    graph = home.start("launch", "launch/asks.yaml")
    while not list(home.runtime_dir.glob("palp/*/graph.json")):
        assert graph.poll() is None, graph.communicate()
    bridge = home.start("bridge", "ros2", home.folder / "asks_map.py")
    assert bridge.stdout is not None
    begun = bridge.stdout.readline()
    assert "(1 topic to ROS 2, 1 call)" in begun, bridge.communicate()
    answered(home, "First")
    swap = home.start("swap", "asker", "nodes.asks:Second")
    assert swap.wait(PATIENCE_S) == 0, swap.communicate()
    answered(home, "Second")
    bridge.send_signal(signal.SIGINT)
    out, err = bridge.communicate(timeout=PATIENCE_S)
    assert bridge.returncode == 130
    assert "/asker/told -> /told: 2 crossed, 0 lost" in out
    assert "no node of ROS 2 serves /switch" in err
    assert graph.poll() is None
