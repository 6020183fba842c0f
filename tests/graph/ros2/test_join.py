"""A node of another host that joins the graph after the bridge has begun crosses as any other."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from tests.graph.ros2.own_domain import NEEDS_RCLPY, own_domain, run_node
from tests.support.hosts import Host, joining, own_host, trusting
from tests.support.palp import PATIENCE_S

pytestmark = NEEDS_RCLPY

MAP = """
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


@pytest.fixture
def home() -> Iterator[Host]:
    with own_host() as host:
        host.environment |= own_domain()
        (host.folder / "tick_map.py").write_text(MAP, encoding="utf-8")
        yield host


@pytest.fixture
def away(home: Host) -> Iterator[Host]:
    with own_host() as host:
        trusting(home, host)
        yield host


def hear(host: Host, topic: str, node: str) -> str:
    """Have a node of ROS 2's own hear a topic and ask for a node's parameters."""
    return run_node("hears.py", host.environment, topic, node).strip()


def test_what_a_map_says_of_a_node_crosses_once_it_has_joined(home: Host, away: Host) -> None:
    graph = home.launch()
    bridge = home.start("bridge", "ros2", home.folder / "tick_map.py")
    assert bridge.stdout is not None
    begun = bridge.stdout.readline()
    assert "bridge to ROS 2 as /home_bridge (1 topic to ROS 2" in begun, bridge.communicate()
    assert "for nodes that have yet to join: /guest/tick" in begun
    assert hear(home, "/at_home", "ticker") == "count, rate_hz, size"
    guest = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "guest"))
    assert hear(home, "/away", "guest") == "count, rate_hz, size"
    bridge.send_signal(signal.SIGINT)
    out, err = bridge.communicate(timeout=PATIENCE_S)
    assert (bridge.returncode, err) == (130, "")
    assert "/guest/tick -> /away: " in out
    assert out.count(", 0 lost") == 2
    assert guest.poll() is None
    graph.end()


def test_where_nobody_can_join_an_unknown_node_is_a_mistake(home: Host) -> None:
    book = home.book()
    home.start("launch", home.file, f"notes:={book.path}")
    book.until("active")
    refused = home.run("bridge", "ros2", home.folder / "tick_map.py", "--check")
    assert refused.returncode == 2
    assert "tick_map.py:16:1: no topic '/guest/tick'" in refused.stderr
