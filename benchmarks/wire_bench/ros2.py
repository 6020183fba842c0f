"""The rival that people have: ROS 2 (rclpy, Fast DDS), reliable, one process per end.

The array travels as the ``data`` of a ``sensor_msgs/Image``, which rclpy takes and gives as one buffer (the
fastest of the standard messages for bytes), and is read as a numpy array.

Run by the bench, where rclpy is installed: ``python ros2.py pitcher|catcher FOLDER NUMBER READERS``.
"""

from __future__ import annotations

import gc
import sys
import time
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from drive import Array, Drive, sleep_until
from meter import sign_in
from plan import Arrivals
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Image

DEPTH = 1000
END = 0xFFFFFFFF
QOS = QoSProfile(depth=DEPTH, reliability=QoSReliabilityPolicy.RELIABLE)


def image(index: int, stamp_ns: int, data: array[int], count: int = 0) -> Any:
    """Return a message: the index in height and width, the count in step."""
    message = Image()
    message.height, message.width, message.step = index >> 32, index & END, count
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.data = data
    return message


def content(message: Any) -> tuple[int, int]:
    """Return index and stamp."""
    stamp = message.header.stamp
    return message.height << 32 | message.width, stamp.sec * 10**9 + stamp.nanosec


class Pitcher(Drive):
    """The publishing end; waits for its readers."""

    def __init__(self, folder: Path, readers: int) -> None:
        super().__init__(folder)
        self.node = rclpy.create_node("pitcher")
        self.publisher = self.node.create_publisher(Image, "block", QOS)
        self.replies: list[Any] = []
        self.node.create_subscription(Image, "reply", self.replies.append, QOS)
        while self.publisher.get_subscription_count() < readers or not self.node.count_publishers("reply"):
            sleep_until(time.monotonic_ns() + 10_000_000)
        sleep_until(time.monotonic_ns() + 300_000_000)  # the readers' side of the discovery
        self.bodies: dict[int, array[int]] = {}
        gc.collect()
        gc.freeze()

    def send(self, index: int, values: Array) -> None:
        body = self.bodies.get(values.nbytes)
        if body is None:
            body = self.bodies[values.nbytes] = array("B", values.tobytes())
        self.publisher.publish(image(index, time.monotonic_ns(), body))

    def receive(self, timeout_ns: int) -> tuple[int, int, int] | None:
        until_ns = time.monotonic_ns() + timeout_ns
        while not self.replies and (left_ns := until_ns - time.monotonic_ns()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left_ns / 1e9)
        if not self.replies:
            return None
        message = self.replies.pop(0)
        return (*content(message), message.step)

    def end(self) -> None:
        """Tell the readers to end."""
        self.publisher.publish(image(END << 32, 0, array("B")))
        sleep_until(time.monotonic_ns() + 300_000_000)


def catch(folder: Path, number: int) -> None:
    """Be the reading end until its publisher ends."""
    sign_in(folder)
    node = rclpy.create_node(f"catcher{number}")
    reply = node.create_publisher(Image, "reply", QOS) if number == 0 else None
    arrivals, empty, done = Arrivals(), array("B"), []

    def take(message: Any) -> None:
        np.frombuffer(message.data)
        arrived_ns = time.monotonic_ns()
        index, sent_ns = content(message)
        if message.height == END:
            done.append(True)
        elif arrivals.take(index, sent_ns, arrived_ns) and reply is not None:
            reply.publish(image(index, sent_ns, empty, arrivals.count))

    node.create_subscription(Image, "block", take, QOS)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    gc.collect()
    gc.freeze()
    while not done:
        executor.spin_once()
    arrivals.write(folder / f"arrivals{number}.npy")


if __name__ == "__main__":
    role, place, which, reader_count = sys.argv[1:]
    rclpy.init()
    if role == "pitcher":
        pitcher = Pitcher(Path(place), int(reader_count))
        pitcher.run()
        pitcher.end()
    else:
        catch(Path(place), int(which))
    rclpy.shutdown()
