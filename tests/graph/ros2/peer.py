"""A node of ROS 2's own, by bare rclpy: ``all``, ``hear TOPIC NODE``, ``serve WANTED``; prints JSON."""

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
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64, Int64, String
from std_srvs.srv import SetBool, Trigger

PATIENCE_S = 60.0
RELIABLE = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Peer:
    """A node that waits for what is to come, as long as it takes."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("peer")
        self.received: list[Any] = []

    def until(self, so: Callable[[], Any]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not so():
            assert time.monotonic() < end_s, f"not so in time, but {self.received[-3:]}"
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def listed(self, node: str) -> list[str]:
        return list(
            self.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
        )

    def set(self, value: float) -> Any:
        given = Parameter(name="block_hz", value=ParameterValue(type=3, double_value=value))
        request = SetParameters.Request(parameters=[given])
        (result,) = self.call(SetParameters, "/sensor/set_parameters", request).results
        return [result.successful, result.reason]

    def all(self) -> Any:
        """Take part in everything that the example's map names."""
        node, names = self.node, ["block_hz"]
        node.create_subscription(WrenchStamped, "/wrench", self.received.append, RELIABLE)
        load = node.create_publisher(Float64, "/load", RELIABLE)

        def is_torque(value: float) -> Callable[[], bool]:
            return lambda: self.received[-1].wrench.torque.x == value

        self.until(lambda: load.get_subscription_count() and self.received)
        stamp = self.received[-1].header.stamp
        told: dict[str, Any] = {
            "age_s": node.get_clock().now().nanoseconds / 1e9 - stamp.sec - stamp.nanosec / 1e9
        }
        for i in range(1, 101):
            load.publish(Float64(data=i / 8))
        self.until(is_torque(12.5))
        told["frame"] = self.received[-1].header.frame_id
        told["topics"] = {name: kinds for name, kinds in node.get_topic_names_and_types() if "o" in name}
        answer = self.call(Trigger, "/tare", Trigger.Request())
        told["tare"] = [answer.success, answer.message]
        self.until(is_torque(0.0))
        told["listed"] = self.listed("sensor")
        asked = DescribeParameters.Request(names=names)
        described = self.call(DescribeParameters, "/sensor/describe_parameters", asked)
        told["described"] = described.descriptors[0].description
        told["refused"], told["set"] = self.set(-1.0), self.set(25.0)
        got = self.call(GetParameters, "/sensor/get_parameters", GetParameters.Request(names=names))
        return told | {"got": got.values[0].double_value}

    def hear(self, topic: str, name: str) -> Any:
        """Hear a message; return the names of a node's parameters."""
        self.node.create_subscription(Int64, topic, self.received.append, 10)
        self.until(lambda: self.received)
        return self.listed(name)

    def serve(self, wanted: str) -> Any:
        """Serve a switch until a latched /told is heard by a reader that comes late, each time."""

        def answer(request: Any, response: Any) -> Any:
            response.success, response.message = request.data, "switched"
            return response

        self.node.create_service(SetBool, "/switch", answer)
        end_s = time.monotonic() + PATIENCE_S
        while not any(wanted in one.data for one in self.received):
            assert time.monotonic() < end_s, f"not heard, but {self.received}"
            self.node.create_subscription(String, "/told", self.received.append, LATCHED)
            for _ in range(20):
                rclpy.spin_once(self.node, timeout_sec=0.1)
        return self.received[-1].data


rclpy.init()
sys.stdout.write(json.dumps(getattr(Peer(), sys.argv[1])(*sys.argv[2:])) + "\n")
rclpy.shutdown()
