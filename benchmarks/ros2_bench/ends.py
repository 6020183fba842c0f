"""ROS 2's ends, by bare rclpy: ``python ends.py write TOPIC COUNT RATE_HZ`` or ``read TOPIC COUNT FILE``.

A reader passes over what comes in its first half second, while both sides find each other.
"""

from __future__ import annotations

import gc
import sys
import time
from threading import Event
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy

QOS = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.RELIABLE)
SETTLE_NS = 500_000_000
LONGEST_NS = 60_000_000_000


def write(topic: str, count: int, rate_hz: float) -> None:
    """Send samples on a grid of absolute times, once a reader is there."""
    node = rclpy.create_node("writer")
    publisher = node.create_publisher(WrenchStamped, topic, QOS)
    while not publisher.get_subscription_count():
        _sleep_until(time.monotonic_ns() + 10_000_000)
    begin_ns = time.monotonic_ns() + SETTLE_NS
    gc.freeze()
    for index in range(1, count + 1):
        _sleep_until(begin_ns + round(index * 1e9 / rate_hz))
        message = WrenchStamped()
        now = node.get_clock().now().to_msg()
        message.header.stamp = now
        message.wrench.force.x, message.wrench.torque.x = float(index), 0.5
        message.wrench.force.y = float(time.monotonic_ns())
        publisher.publish(message)
    _sleep_until(time.monotonic_ns() + SETTLE_NS)  # what is under way arrives


def read(topic: str, count: int, file: str) -> None:
    """Take samples: index, when each was sent, when it arrived."""
    node, rows = rclpy.create_node("reader"), list[tuple[float, float, int]]()

    def take(message: Any) -> None:
        rows.append((message.wrench.force.x, message.wrench.force.y, time.monotonic_ns()))

    node.create_subscription(WrenchStamped, topic, take, QOS)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    gc.freeze()
    end_ns = time.monotonic_ns() + LONGEST_NS
    while time.monotonic_ns() < end_ns and not (rows and rows[-1][0] - rows[0][0] >= count - 1):
        executor.spin_once(0.1)
    np.save(file, np.array(rows, np.float64).reshape(-1, 3))


def _sleep_until(at_ns: int) -> None:
    left_s = (at_ns - time.monotonic_ns()) / 1e9
    if left_s > 0:
        Event().wait(left_s)


if __name__ == "__main__":
    role, name, number, last = sys.argv[1:]
    rclpy.init()
    if role == "write":
        write(name, int(number), float(last))
    else:
        read(name, int(number), last)
    rclpy.shutdown()
