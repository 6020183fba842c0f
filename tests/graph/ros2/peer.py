"""The other side of the bridge: a node of ROS 2's own, by bare rclpy; prints JSON."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

PATIENCE_S = 60.0
RELIABLE = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.RELIABLE)


class Peer:
    """A node that waits for what is to come, as long as it takes."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("peer")
        self.wrenches: list[Any] = []
        self.node.create_subscription(WrenchStamped, "/wrench", self.wrenches.append, RELIABLE)
        self.load = self.node.create_publisher(Float64, "/load", RELIABLE)

    def until(self, so: Callable[[], Any]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not so():
            assert time.monotonic() < end_s, "not so in time"
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def torque(self, value: float) -> Callable[[], bool]:
        return lambda: bool(self.wrenches) and self.wrenches[-1].wrench.torque.x == value

    def set(self, value: float) -> Any:
        given = Parameter(name="block_hz", value=ParameterValue(type=3, double_value=value))
        request = SetParameters.Request(parameters=[given])
        (result,) = self.call(SetParameters, "/sensor/set_parameters", request).results
        return [result.successful, result.reason]


def main() -> None:
    rclpy.init()
    peer = Peer()
    peer.until(lambda: peer.load.get_subscription_count() and peer.wrenches)
    told: dict[str, Any] = {"age_s": _age_s(peer)}
    for i in range(1, 101):
        peer.load.publish(Float64(data=i / 8))
    peer.until(peer.torque(12.5))
    told["frame"] = peer.wrenches[-1].header.frame_id
    told["topics"] = {name: kinds for name, kinds in peer.node.get_topic_names_and_types() if "o" in name}
    answer = peer.call(Trigger, "/tare", Trigger.Request())
    told["tare"] = [answer.success, answer.message]
    peer.until(peer.torque(0.0))
    names = ["block_hz"]
    told["listed"] = peer.call(
        ListParameters, "/sensor/list_parameters", ListParameters.Request()
    ).result.names
    described = peer.call(
        DescribeParameters, "/sensor/describe_parameters", DescribeParameters.Request(names=names)
    )
    told["described"] = described.descriptors[0].description
    told["refused"], told["set"] = peer.set(-1.0), peer.set(25.0)
    got = peer.call(GetParameters, "/sensor/get_parameters", GetParameters.Request(names=names))
    told["got"] = got.values[0].double_value
    sys.stdout.write(json.dumps(told) + "\n")
    peer.node.destroy_node()
    rclpy.shutdown()


def _age_s(peer: Peer) -> float:
    stamp = peer.wrenches[-1].header.stamp
    return float(peer.node.get_clock().now().nanoseconds / 1e9 - stamp.sec - stamp.nanosec / 1e9)


main()
