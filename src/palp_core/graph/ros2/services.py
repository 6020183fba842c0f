"""Services both ways: ROS 2 calls those of the graph, a topic of the graph calls those of ROS 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from palp_core.errors import GraphError, PalpError
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import Frame
from palp_core.graph.messages.message import decode
from palp_core.graph.ros2.maps import Entry, Times, as_message, as_plain
from palp_core.graph.ros2.middleware import installed_type
from palp_core.graph.ros2.ports import Account

ASK_S = 5.0


def offer(graph: RunningGraph, entry: Entry, node: Any, now: Callable[[], Times], account: Account) -> None:
    _, name, port = entry.palp.split("/")

    def answer(request: Any, response: Any) -> Any:
        try:
            with entry.catch():
                steps = entry.convert(request, response, now())
                wanted = as_plain(next(steps))
                asked = graph.ask(name, "call", timeout_s=ASK_S, service=port, request=wanted)
                found = _returned(steps, as_message(entry.messages[1], asked["reply"]))
        except PalpError as error:
            account.refuse(str(error))
            if isinstance(getattr(response, "message", None), str):
                response.message = str(error)
            return response
        account.cross()
        return found

    node.create_service(installed_type(entry.ros_type), entry.ros, answer)


def caller(graph: RunningGraph, entry: Entry, node: Any, account: Account) -> Callable[[Frame, Times], None]:
    """Return the function that calls a service of ROS 2 for a message of the graph.

    The arguments are those of :func:`offer`.
    """
    kind = installed_type(entry.ros_type)
    client = node.create_client(kind, entry.ros)

    def call(frame: Frame, times: Times) -> None:
        if not client.service_is_ready():
            account.refuse(f"no node of ROS 2 serves {entry.ros}")
            return
        try:
            with entry.catch():
                steps = entry.convert(decode(entry.messages[0], frame.payload), kind.Request(), times)
                client.call_async(next(steps)).add_done_callback(lambda future: answered(steps, future))
        except PalpError as error:
            account.refuse(str(error))

    def answered(steps: Any, future: Any) -> None:
        try:
            with entry.catch():
                message = _returned(steps, future.result())
                if entry.to:
                    _, name, port = entry.to.split("/")
                    graph.ask(name, "publish", timeout_s=ASK_S, port=port, message=as_plain(message))
        except PalpError as error:
            account.refuse(str(error))
        else:
            account.cross()

    return call


def _returned(steps: Any, answer: Any) -> Any:
    """Send the answer to a generator; return what it returns."""
    try:
        steps.send(answer)
    except StopIteration as end:
        return end.value
    raise GraphError("the map's function yields a second time; it must return then")
