"""rclpy, as far as the bridge needs it: bytes out, bytes in, and threads that end."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

from palp_core.errors import GraphError
from palp_core.extras import install_line
from palp_core.graph.bag.ros2.definitions import Definitions
from palp_core.graph.messages.qos import Qos
from palp_core.graph.ros2.type_support import forget_error, message_type

INSTALL = f"{install_line('ros2')}, or source a ROS 2 installation for this Python"
TURN_S = 0.1
JOIN_S = 5.0
NS = 1_000_000_000

Arrived = Callable[[bytes, Any, int], None]
"""Takes a message's bytes, who published it (None: not known) and its number there."""


def require() -> None:
    """See whether rclpy is there.

    Raises:
        GraphError: It is not, or it does not work.
    """
    try:
        import rclpy  # noqa: F401
        from rclpy.executors import SingleThreadedExecutor  # noqa: F401
        from rclpy.qos import QoSProfile  # noqa: F401
    except ImportError as error:
        raise GraphError(f"rclpy cannot be used: {error}; {INSTALL}") from error


def beyond_this_host() -> str:
    """Return why ROS 2 nodes of other hosts are in reach, in words; "" if they are not."""
    if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in ("LOCALHOST", "OFF"):
        return ""
    if os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        return ""
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    return (
        f"every ROS 2 node of domain {domain} in this network takes part; "
        "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST keeps it on this host"
    )


def profile(qos: Qos) -> Any:
    """Return a quality of service as rclpy has it; ``max_blocking_ms`` it has not."""
    from rclpy.duration import Duration
    from rclpy.qos import (
        QoSDurabilityPolicy,
        QoSHistoryPolicy,
        QoSLivelinessPolicy,
        QoSProfile,
        QoSReliabilityPolicy,
    )

    times = {
        "deadline": qos.deadline_ms,
        "lifespan": qos.lifespan_ms,
        "liveliness_lease_duration": qos.lease_ms,
    }
    return QoSProfile(
        reliability=QoSReliabilityPolicy[qos.reliability.upper()],
        durability=QoSDurabilityPolicy[qos.durability.upper()],
        history=QoSHistoryPolicy[qos.history.upper()],
        depth=qos.depth,
        liveliness=QoSLivelinessPolicy[qos.liveliness.upper()],
        **{name: Duration(nanoseconds=round(ms * 1e6)) for name, ms in times.items() if ms},
    )


class Middleware:
    """The bridge's nodes in ROS 2, and the threads that serve them.

    Args:
        name: What its node for topics is called.
        definitions: Of message types.

    Raises:
        GraphError: ROS 2 cannot be begun.
    """

    def __init__(self, name: str, definitions: Definitions) -> None:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        self._definitions = definitions
        self._context = rclpy.Context()
        self._ending = False
        self._threads: list[threading.Thread] = []
        self._nodes: list[Any] = []
        self._executors: dict[str, Any] = {}
        self._served: dict[str, Any] = {}
        try:
            rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            self.topics = self.node(name)
        except Exception as error:  # rclpy's own, of no common base
            raise GraphError(f"ROS 2 cannot be begun: {error}") from error

    def node(self, name: str) -> Any:
        """Return a new node without parameters of its own."""
        import rclpy

        made = rclpy.create_node(
            name, context=self._context, start_parameter_services=False, enable_rosout=False
        )
        self._nodes.append(made)
        return made

    def publisher(self, topic: str, type_name: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes a message's bytes."""
        kind = message_type(self._definitions, type_name)
        publish: Callable[[bytes], None] = self.topics.create_publisher(kind, topic, profile(qos)).publish
        forget_error()
        return publish

    def subscribe(self, topic: str, type_name: str, qos: Qos, arrived: Arrived) -> None:
        """Hand over every message of a topic, in the thread that serves topics."""

        def take(data: bytes, info: Any) -> None:
            publisher = info.get("publisher_gid") or {}
            arrived(data, publisher.get("data"), info.get("publication_sequence_number") or 0)

        kind = message_type(self._definitions, type_name)
        self.topics.create_subscription(kind, topic, take, profile(qos), raw=True)
        forget_error()

    def served(self, group: str, name: str) -> Any:
        """Return the node of a name, new when it is first asked for, which the thread of its group serves."""
        if name in self._served:
            return self._served[name]
        node = self._served[name] = self.node(name)
        if group in self._executors:
            self._executors[group].add_node(node)
        else:
            self.serve(group, node)
        return node

    def serve(self, group: str, node: Any, each_turn: Callable[[], None] = lambda: None) -> None:
        """Serve a node from now on, the first of its group, in a thread of the group's own."""
        from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor

        executor = self._executors[group] = SingleThreadedExecutor(context=self._context)
        executor.add_node(node)

        def turn() -> None:
            while not self._ending:
                try:
                    executor.spin_once(timeout_sec=TURN_S)
                except (ExternalShutdownException, ShutdownException):
                    return
                each_turn()

        thread = threading.Thread(target=turn, name=f"ros2 {group}", daemon=True)
        self._threads.append(thread)
        thread.start()

    def close(self) -> None:
        """Leave ROS 2."""
        import rclpy

        self._ending = True
        for thread in self._threads:
            thread.join(JOIN_S)
        for executor in self._executors.values():
            executor.shutdown(JOIN_S)
        for node in self._nodes:
            node.destroy_node()
        rclpy.shutdown(context=self._context, uninstall_handlers=False)
