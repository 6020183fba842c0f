"""A node of ROS 2's own, by bare rclpy: serves /switch until a latched /told is heard, and prints that."""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import SetBool

PATIENCE_S = 60.0


def answer(request: Any, response: Any) -> Any:
    response.success, response.message = request.data, "switched"
    return response


def main(wanted: str) -> None:
    rclpy.init()
    node, heard = rclpy.create_node("serves"), list[Any]()
    node.create_service(SetBool, "/switch", answer)
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    end_s = time.monotonic() + PATIENCE_S
    while not any(wanted in one.data for one in heard):
        assert time.monotonic() < end_s, f"not heard, but {heard}"
        node.create_subscription(String, "/told", heard.append, latched)  # comes late, each time
        for _ in range(20):
            rclpy.spin_once(node, timeout_sec=0.1)
    sys.stdout.write(heard[-1].data + "\n")
    node.destroy_node()
    rclpy.shutdown()


main(sys.argv[1])
