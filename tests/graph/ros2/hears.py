"""A node of ROS 2's own, by bare rclpy: ``hears.py TOPIC NODE`` hears a message, names parameters."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import Int64

PATIENCE_S = 60.0


def main(topic: str, name: str) -> None:
    rclpy.init()
    node, heard = rclpy.create_node("hears"), list[Any]()
    node.create_subscription(Int64, topic, heard.append, 10)

    def until(so: Callable[[], Any]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not so():
            assert time.monotonic() < end_s, "not so in time"
            rclpy.spin_once(node, timeout_sec=0.1)

    until(lambda: heard)
    client = node.create_client(ListParameters, f"/{name}/list_parameters")
    until(client.service_is_ready)
    asked = client.call_async(ListParameters.Request())
    until(asked.done)
    answer: Any = asked.result()
    sys.stdout.write(", ".join(answer.result.names) + "\n")
    node.destroy_node()
    rclpy.shutdown()


main(*sys.argv[1:])
