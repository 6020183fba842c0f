"""rclpy, as far as the bridge needs it: bytes out, bytes in, and two threads that end."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from importlib import import_module
from typing import Any

from palp_core.errors import GraphError
from palp_core.extras import install_line
from palp_core.foreign import describe_foreign
from palp_core.graph.messages.qos import Qos

INSTALL = f"{install_line('ros2')}, or source a ROS 2 installation for this Python"
JOIN_S = 5.0

Arrived = Callable[[bytes, dict[str, Any]], None]
"""Takes a message's bytes and rclpy's account of it: publisher and sequence number."""


def require() -> None:
    try:
        import rclpy.executors
        import rclpy.qos  # noqa: F401
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


def installed_type(name: str) -> Any:
    package, kind, title = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), title)
    except (ImportError, AttributeError) as error:
        raise GraphError(
            f"{name} is not installed for Python, left out; build {package} and source its workspace"
        ) from error


def profile(qos: Qos) -> Any:
    """Return a quality of service as rclpy has it, which lacks ``max_blocking_ms``."""
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
    """The bridge's nodes in ROS 2, each served by one of two threads: topics, and services."""

    def __init__(self, name: str, report: Callable[[str], None]) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self._report, self._ending = report, False
        self._context = rclpy.Context()
        try:
            rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            self._executors = {
                one: SingleThreadedExecutor(context=self._context) for one in ("topics", "services")
            }
            self._nodes: dict[str, Any] = {}
            self.topics = self.node(name, "topics")
        except Exception as error:  # rclpy's own, of no common base
            raise GraphError(f"ROS 2 cannot be begun: {error}") from error
        self._threads = [
            threading.Thread(target=self._spin, args=(executor,), name=f"ros2 {name}", daemon=True)
            for name, executor in self._executors.items()
        ]
        for thread in self._threads:
            thread.start()

    def _spin(self, executor: Any) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        while not self._ending:
            try:
                executor.spin()
            except (ExternalShutdownException, ShutdownException):
                return
            except Exception as error:  # noqa: BLE001 - one handler's failure must not end the others
                self._report(f"a message of ROS 2 was not handled: {describe_foreign(error)}")

    def node(self, name: str, group: str = "services") -> Any:
        """Return the node of a name, made when it is first asked for, without parameters of its own."""
        import rclpy

        if name not in self._nodes:
            self._nodes[name] = rclpy.create_node(
                name, context=self._context, start_parameter_services=False, enable_rosout=False
            )
            self._executors[group].add_node(self._nodes[name])
        return self._nodes[name]

    def publisher(self, topic: str, type_name: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes a message's bytes."""
        publish: Callable[[bytes], None] = self.topics.create_publisher(
            installed_type(type_name), topic, profile(qos)
        ).publish
        return publish

    def subscribe(self, topic: str, type_name: str, qos: Qos, arrived: Arrived) -> None:
        """Hand over every message of a topic, in the thread for topics."""
        self.topics.create_subscription(installed_type(type_name), topic, arrived, profile(qos), raw=True)

    def close(self) -> None:
        import rclpy

        self._ending = True
        for executor in self._executors.values():
            executor.shutdown(JOIN_S)
        for thread in self._threads:
            thread.join(JOIN_S)
        for node in self._nodes.values():
            node.destroy_node()
        rclpy.shutdown(context=self._context, uninstall_handlers=False)
