"""A node of another host that joins the graph after the bridge has begun crosses as any other."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import zlib
from collections.abc import Iterator

import pytest

from tests.support.hosts import Host, joining, own_host, trusting
from tests.support.palp import PATIENCE_S, ROOT

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        importlib.util.find_spec("rclpy") is None, reason="needs rclpy: pip install --editable '.[dev,ros2]'"
    ),
]

HEARS = ROOT / "tests/graph/ros2/hears.py"
MAP = """\
to_ros2:
  - {palp: /ticker/tick, ros: /at_home, type: std_msgs/msg/Int64, fields: {data: index}}
  - {palp: /guest/tick, ros: /away, type: std_msgs/msg/Int64, fields: {data: index}}
parameters: all
"""


@pytest.fixture
def home() -> Iterator[Host]:
    domain = 1 + zlib.crc32(os.environ.get("PYTEST_XDIST_WORKER", str(os.getpid())).encode()) % 100
    with own_host() as host:
        host.environment |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        (host.folder / "map.yaml").write_text(MAP, encoding="utf-8")
        yield host


@pytest.fixture
def away(home: Host) -> Iterator[Host]:
    with own_host() as host:
        trusting(home, host)
        yield host


def hear(host: Host, topic: str, node: str) -> str:
    """Have a node of ROS 2's own hear a topic and ask for a node's parameters."""
    done = subprocess.run(
        [sys.executable, HEARS, topic, node],
        env=host.environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_a_map_says_of_a_node_crosses_once_it_has_joined(home: Host, away: Host) -> None:
    graph = home.launch()
    bridge = home.start("ros2", "bridge", home.folder / "map.yaml")
    assert bridge.stdout is not None
    begun = bridge.stdout.readline()
    assert "beside ROS 2, as /palp_bridge (1 topics to ROS 2" in begun, bridge.communicate()
    assert "what is said of nodes that have yet to join: /guest/tick" in begun
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
    refused = home.run("ros2", "bridge", home.folder / "map.yaml", "--check")
    assert refused.returncode == 2
    assert "map.yaml:3:12: no topic '/guest/tick'" in refused.stderr
