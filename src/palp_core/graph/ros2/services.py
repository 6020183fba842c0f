"""Services both ways: ROS 2 calls those of the graph, a topic of the graph asks those of ROS 2."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from importlib import import_module
from typing import Any

import msgspec

from palp_core.errors import BagError, GraphError
from palp_core.graph.bag.ros2.definitions import Definitions
from palp_core.graph.bag.ros2.values import reader, writer
from palp_core.graph.clock import unix_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import Frame
from palp_core.graph.ros2.account import Account
from palp_core.graph.ros2.crossing import part_of
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.plan import BridgePlan, ServiceCall, ServiceCrossing

ASK_S = 5.0


class Services:
    """The services of a bridge.

    Args:
        graph: The graph.
        definitions: Of message types.
        times: What becomes of times.
        account: Makes an account.
    """

    def __init__(
        self, graph: RunningGraph, definitions: Definitions, times: Times, account: Callable[[str], Account]
    ) -> None:
        self._graph, self._definitions, self._times = graph, definitions, times
        self._account = account
        self._decode = msgspec.msgpack.Decoder().decode
        self._asking: dict[str, list[Callable[[Frame], None]]] = {}

    def add(self, plan: BridgePlan, node: Any) -> None:
        """Let the services of a plan cross.

        Args:
            plan: What crosses.
            node: ROS 2's node for them.

        Raises:
            GraphError: A service's type is not installed for Python.
        """
        for service in plan.services:
            self._offer(node, service, self._account(f"{service.way.ros} calls {service.way.palp}"))
        for call in plan.calls:
            ask = self._caller(node, call, self._account(f"{call.way.palp} calls {call.way.ros}"))
            self._asking.setdefault(call.topic.name, []).append(ask)

    def ask_of(self, frame: Frame) -> None:
        """Ask what a message of the graph asks of ROS 2, if anything."""
        for ask in self._asking.get(frame.topic, ()):
            ask(frame)

    def close(self) -> None:
        """Ask nothing any more."""
        self._asking.clear()

    def _now_ns(self) -> int:
        return self._times.to_palp(unix_ns())

    def _offer(self, node: Any, service: ServiceCrossing, account: Account) -> None:
        kind = _service_type(service.way.type)
        read, write = self._bytes(service.way.type, "Request", "Response")

        def answer(request: Any, response: Any) -> Any:
            try:
                message = service.request(read(_to_cdr(request)), self._now_ns())
                asked = self._graph.ask(
                    service.node, "call", timeout_s=ASK_S, service=service.port, request=message
                )
                reply = service.reply(asked["reply"], self._now_ns())
            except (BagError, GraphError, LookupError) as error:
                account.refuse(str(error))
                return _failed(response, str(error))
            account.cross()
            return _from_cdr(write(reply), kind.Response)

        node.create_service(kind, service.way.ros, answer)

    def _caller(self, node: Any, call: ServiceCall, account: Account) -> Callable[[Frame], None]:
        kind = _service_type(call.way.type)
        client = node.create_client(kind, call.way.ros)
        read, write = self._bytes(call.way.type, "Response", "Request")
        under_way: deque[Any] = deque()

        def answered(future: Any) -> None:
            under_way.remove(future)
            try:
                if call.reply is not None:
                    message = call.reply(read(_to_cdr(future.result())), self._now_ns())
                    self._graph.ask(call.node, "publish", timeout_s=ASK_S, port=call.port, message=message)
            except (BagError, GraphError, LookupError) as error:
                account.refuse(str(error))
            else:
                account.cross()

        def ask(frame: Frame) -> None:
            if not client.service_is_ready():
                account.refuse(f"nobody in ROS 2 serves {call.way.ros}")
                return
            try:
                request = call.request(self._decode(frame.payload), frame.stamp_ns)
                future = client.call_async(_from_cdr(write(request), kind.Request))
            except (BagError, LookupError, msgspec.MsgspecError) as error:
                account.refuse(str(error))
                return
            under_way.append(future)
            future.add_done_callback(answered)

        return ask

    def _bytes(
        self, name: str, read: str, write: str
    ) -> tuple[Callable[[bytes], Any], Callable[[Any], bytes]]:
        return (
            reader(self._definitions, part_of(name, read)),
            writer(self._definitions, part_of(name, write)),
        )


def _service_type(name: str) -> Any:
    package, _, title = name.split("/")
    try:
        return getattr(import_module(f"{package}.srv"), title)
    except (ImportError, AttributeError) as error:
        raise GraphError(
            f"{name} is not installed for Python, and a service's type must be: build {package} and source "
            "its workspace, or take one of std_srvs"
        ) from error


def _to_cdr(message: Any) -> bytes:
    from rclpy.serialization import serialize_message

    return bytes(serialize_message(message))


def _from_cdr(data: bytes, kind: Any) -> Any:
    from rclpy.serialization import deserialize_message

    return deserialize_message(data, kind)


def _failed(response: Any, words: str) -> Any:
    """Return the response that says so, where the type has a place for it."""
    if isinstance(getattr(response, "message", None), str):
        response.message = words
    return response
