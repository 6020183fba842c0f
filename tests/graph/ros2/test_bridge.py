"""The bridge between a running graph and nodes of ROS 2's own, over Fast DDS on this host's loopback."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.graph.ros2.beside import NEEDS_RCLPY, own_domain, run_node
from tests.support.palp import PATIENCE_S, ROOT, Palp

pytestmark = NEEDS_RCLPY

GRAPH = ROOT / "examples/interop/launch/interop.yaml"
MAP = """\
to_ros2:
  - palp: /sensor/torque
    ros: /wrench
    type: geometry_msgs/msg/WrenchStamped
    fields: {header.stamp: stamp_ns, header.frame_id: {value: probe}, wrench.torque.x: "torque_n_m[-1]"}
  - {palp: /sensor/torque, ros: /block}
to_palp:
  - ros: /load
    palp: /sensor/load
    type: std_msgs/msg/Float64
    fields: {torque_n_m: data}
    qos: {depth: 1000}
services:
  - palp: /sensor/tare
    ros: /tare
    type: std_srvs/srv/Trigger
    reply: {success: true, message: {value: tared}}
parameters: [sensor]
"""


@pytest.fixture
def beside(palp: Palp, tmp_path: Path) -> Palp:
    """The command line beside ROS 2."""
    palp.environment |= own_domain()
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    return palp


def start(palp: Palp, tmp_path: Path) -> tuple[subprocess.Popen[str], subprocess.Popen[str]]:
    """Start graph and bridge; return both when they are there."""
    graph = palp.start("launch", GRAPH)
    while not list(palp.runtime_dir.glob("palp/*/graph.json")):
        assert graph.poll() is None, graph.communicate()
    bridge = palp.start("bridge", "ros2", tmp_path / "map.yaml")
    assert bridge.stdout is not None
    begun = bridge.stdout.readline()
    assert "beside ROS 2, as /palp_bridge (2 topics to ROS 2, 1 topic from ROS 2" in begun, (
        bridge.communicate()
    )
    return graph, bridge


def peer(palp: Palp) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run_node("peer.py", palp.environment))
    return found


def test_all_that_a_map_names_crosses_and_nothing_is_lost(beside: Palp, tmp_path: Path) -> None:
    graph, bridge = start(beside, tmp_path)
    told = peer(beside)
    assert 0.0 <= told.pop("age_s") < 5.0
    assert told["topics"]["/block"] == ["palp_msgs/msg/TorqueBlock"]
    assert told.pop("topics")["/load"] == ["std_msgs/msg/Float64"]
    refused = told.pop("refused")
    assert refused[0] is False
    assert "Expected `float` >= 0.001" in refused[1]
    assert told == {
        "frame": "probe", "tare": [True, "tared"], "listed": ["block_hz"], "described": "float Hz",
        "set": [True, ""], "got": 25.0,
    }  # fmt: skip
    bridge.send_signal(signal.SIGINT)
    out, err = bridge.communicate(timeout=PATIENCE_S)
    assert (bridge.returncode, err) == (130, "")
    assert "/load -> /sensor/load: 100 crossed, 0 lost" in out
    assert "/tare calls /sensor/tare: 1 crossed, 0 lost" in out
    assert out.count(", 0 lost") == 4
    assert graph.poll() is None


def test_the_bridges_death_harms_neither_side_and_another_goes_on(beside: Palp, tmp_path: Path) -> None:
    graph, bridge = start(beside, tmp_path)
    bridge.kill()
    bridge.wait(PATIENCE_S)
    again = beside.start("bridge", "ros2", tmp_path / "map.yaml")
    assert peer(beside)["got"] == 25.0
    assert graph.poll() is None
    graph.terminate()
    out, err = again.communicate(timeout=PATIENCE_S)
    assert again.returncode == 0, err
    assert "graph 'interop' has ended" in err
    assert "/load -> /sensor/load: 100 crossed" in out


def test_a_map_with_mistakes_is_refused_beside_the_graph(beside: Palp, tmp_path: Path) -> None:
    graph, bridge = start(beside, tmp_path)
    bad = tmp_path / "bad.yaml"
    bad.write_text("to_palp: [{ros: /x, palp: /sensor/lod}]\nparameters: [senor]\n", encoding="utf-8")
    refused = beside.run("bridge", "ros2", bad, "--check")
    assert refused.returncode == 2
    assert f"{bad}:1:27: no port '/sensor/lod' takes messages from outside; did you mean" in refused.stderr
    assert f"{bad}:2:14: no node 'senor' in the graph; did you mean 'sensor'?" in refused.stderr
    fine = beside.run("bridge", "ros2", tmp_path / "map.yaml", "--check")
    assert (fine.returncode, fine.stdout.strip()) == (
        0, f"{tmp_path / 'map.yaml'}: no mistake, beside graph 'interop'",
    )  # fmt: skip
    for process in (bridge, graph):
        process.terminate()
        process.wait(PATIENCE_S)
