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
TURN_NS = 100_000_000
MOST_AT_ONCE = 100
"""Messages of one topic after which the others have their turn."""

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

    Messages are taken by a thread that waits for nothing else, and by no executor of rclpy's: those cost more
    for each message than all the rest of its way through the bridge.

    Args:
        name: What its node for topics is called.
        definitions: Of message types.
        each_turn: Called in the thread that takes messages, after each that came and ten times a second.

    Raises:
        GraphError: ROS 2 cannot be begun.
    """

    def __init__(
        self, name: str, definitions: Definitions, each_turn: Callable[[], None] = lambda: None
    ) -> None:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        self._definitions, self._each_turn = definitions, each_turn
        self._context = rclpy.Context()
        self._ending = False
        self._threads: list[threading.Thread] = []
        self._nodes: list[Any] = []
        self._executors: dict[str, Any] = {}
        self._served: dict[str, Any] = {}
        self._subscribed: list[_Subscribed] = []
        try:
            rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            self.topics = self.node(name)
            self._apart = _group_apart()
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
        made = self.topics.create_publisher(kind, topic, profile(qos))
        forget_error()
        publish: Callable[[bytes], None] = made.handle.publish_raw
        return publish

    def subscribe(self, topic: str, type_name: str, qos: Qos, arrived: Arrived) -> None:
        """Hand over every message of a topic, in the thread that takes messages."""
        kind = message_type(self._definitions, type_name)
        made = self.topics.create_subscription(
            kind, topic, _nothing, profile(qos), raw=True, callback_group=self._apart
        )
        forget_error()
        self._subscribed = [*self._subscribed, _Subscribed(made, arrived)]
        if len(self._subscribed) == 1:
            self._begin("ros2 messages", self._take_messages)

    def _take_messages(self) -> None:
        """Take messages as they come, until the end."""
        from rclpy.impl.implementation_singleton import rclpy_implementation

        ends: list[_Subscribed] = []
        while not self._ending:
            if len(ends) < len(self._subscribed):
                ends = self._subscribed
                events = sum(len(end.events) for end in ends)
                wait_set = rclpy_implementation.WaitSet(len(ends), 0, 0, 0, 0, events, self._context.handle)
            wait_set.clear_entities()
            for end in ends:
                end.add_to(wait_set)
            wait_set.wait(TURN_NS)
            ready = wait_set.get_ready_entities("subscription")
            for end in ends:
                if end.pointer in ready:
                    end.take()
                end.tell(wait_set)
            self._each_turn()

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

    def serve(self, group: str, node: Any) -> None:
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

        self._begin(f"ros2 {group}", turn)

    def _begin(self, name: str, work: Callable[[], None]) -> None:
        thread = threading.Thread(target=work, name=name, daemon=True)
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


class _Subscribed:
    """One topic that is read, and what its end has to be told.

    Both have one condition in Fast DDS: who waits for the one alone is woken by the other, all the time.

    Args:
        subscription: rclpy's end.
        arrived: Takes the messages.
    """

    def __init__(self, subscription: Any, arrived: Arrived) -> None:
        self._handle, self._kind, self._arrived = subscription.handle, subscription.msg_type, arrived
        self.pointer = self._handle.pointer
        self.events = subscription.event_handlers

    def add_to(self, wait_set: Any) -> None:
        """Have it waited for."""
        wait_set.add_subscription(self._handle)
        for event in self.events:
            event.add_to_wait_set(wait_set)

    def take(self) -> None:
        """Take what has come, a bounded number."""
        for _ in range(MOST_AT_ONCE):
            taken = self._handle.take_message(self._kind, True)
            if taken is None:
                return
            data, info = taken
            publisher = info.get("publisher_gid") or {}
            self._arrived(data, publisher.get("data"), info.get("publication_sequence_number") or 0)

    def tell(self, wait_set: Any) -> None:
        """Let rclpy say what has happened to this end."""
        for event in self.events:
            if event.is_ready(wait_set) and (what := event.take_data()):
                event.callback(what)


def _group_apart() -> Any:
    """Return the callback group of what no executor looks after."""
    from rclpy.callback_groups import ReentrantCallbackGroup

    group = ReentrantCallbackGroup()
    group.can_execute = lambda _entity: False
    return group


def _nothing(_data: bytes) -> None:
    """Stand for the callback that no executor calls."""
