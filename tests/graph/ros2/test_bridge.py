"""The bridge between a running graph and nodes of ROS 2's own, over Fast DDS on this host's loopback."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.graph.ros2.own_domain import NEEDS_RCLPY, own_domain, run_node
from tests.support.palp import PATIENCE_S, ROOT, Palp

pytestmark = NEEDS_RCLPY

GRAPH = ROOT / "examples/interop/launch/interop.yaml"
MAP = ROOT / "examples/interop/ros2_map.py"


@pytest.fixture
def beside(palp: Palp) -> Palp:
    """The command line beside ROS 2."""
    palp.environment |= own_domain()
    return palp


def start(palp: Palp) -> tuple[subprocess.Popen[str], subprocess.Popen[str]]:
    """Start graph and bridge; return both when they are there."""
    graph = palp.start("launch", GRAPH)
    while not list(palp.runtime_dir.glob("palp/*/graph.json")):
        assert graph.poll() is None, graph.communicate()
    bridge = palp.start("bridge", "ros2", MAP)
    assert bridge.stdout is not None
    begun = bridge.stdout.readline()
    assert "bridge to ROS 2 as /interop_bridge (2 topics to ROS 2, 1 topic from ROS 2" in begun, (
        bridge.communicate()
    )
    return graph, bridge


def peer(palp: Palp) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run_node("peer.py", palp.environment))
    return found


def test_all_that_a_map_names_crosses_and_nothing_is_lost(beside: Palp) -> None:
    graph, bridge = start(beside)
    told = peer(beside)
    assert 0.0 <= told.pop("age_s") < 5.0
    assert told["topics"]["/torque_samples"] == told.pop("topics")["/load"] == ["std_msgs/msg/Float64"]
    refused = told.pop("refused")
    assert refused[0] is False
    assert "Expected `float` >= 0.001" in refused[1]
    assert told == {
        "frame": "probe", "tare": [True, "tared at 12.5 N m"], "listed": ["block_hz"],
        "described": "float Hz", "set": [True, ""], "got": 25.0,
    }  # fmt: skip
    bridge.send_signal(signal.SIGINT)
    out, err = bridge.communicate(timeout=PATIENCE_S)
    assert (bridge.returncode, err) == (130, "")
    assert "/load -> /sensor/load: 100 crossed, 0 lost" in out
    assert "/tare calls /sensor/tare: 1 crossed, 0 lost" in out
    assert out.count(", 0 lost") == 4
    assert graph.poll() is None


def test_the_bridges_death_harms_neither_side_and_another_goes_on(beside: Palp) -> None:
    graph, bridge = start(beside)
    bridge.kill()
    bridge.wait(PATIENCE_S)
    again = beside.start("bridge", "ros2", MAP)
    assert peer(beside)["got"] == 25.0
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
    graph = beside.start("launch", GRAPH)
    while not list(beside.runtime_dir.glob("palp/*/graph.json")):
        assert graph.poll() is None, graph.communicate()
    bridge = beside.start("bridge", "ros2", file)
    assert peer(beside)["got"] == 25.0
    bridge.send_signal(signal.SIGINT)
    out, err = bridge.communicate(timeout=PATIENCE_S)
    assert "/torque_samples: own_msgs/msg/Own is not installed for Python, left out; build own_msgs" in err
    assert "/torque_samples" not in out
