"""Stop all motion of a graph: by a call to its safety node, or by the space bar while its launch waits."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

from palp_core.cli.keyboard import Keyboard, standard_input
from palp_core.cli.output import note
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.launch.graph import Graph

KEY = " "
KEY_TIMEOUT_S = 5.0


def stop_motion(running: RunningGraph, reason: str, timeout_s: float) -> dict[str, Any]:
    """Trip the safety node of a graph; return its state and cause."""
    return call_safety(running, "stop", {"reason": reason}, timeout_s)


def stopped_text(reply: dict[str, Any], run: str) -> str:
    """Return what is printed of a run whose motion was stopped, and how to go on."""
    from palp_core.graph.discovery.choice import addressed

    return f"{reply['state']}: {reply['cause']}; when all is well: {addressed('palp safety ack', run)}"


def call_safety(
    running: RunningGraph, service: str, request: dict[str, Any], timeout_s: float
) -> dict[str, Any]:
    """Call a service of the safety node, which is the one that stops and acknowledges."""
    from palp_core.graph.discovery.running_graph import safety_node

    node = safety_node(((topic.node, topic.type) for topic in running.record.topics), running.node_names)
    if node is None:
        raise GraphError(
            f"graph '{running.record.graph}' has no safety node, so nothing can be stopped alone;"
            f" end the graph with: palp graph end {running.record.id}"
        )
    answer = running.ask(node, "call", timeout_s=timeout_s, service=service, request=request)
    reply: dict[str, Any] = answer["reply"]
    return reply


def stop_key(graph: Graph) -> StopKey:
    """Return the key that stops a graph's motion; it listens if the graph has a safety node."""
    from palp_core.graph.discovery.running_graph import RunningGraph, safety_node

    def press() -> None:
        record = graph.launcher_node.record
        if record is None:  # it has not begun
            return
        try:
            reply = stop_motion(RunningGraph(record), "the space bar", KEY_TIMEOUT_S)
        except GraphError as error:
            note(str(error))
        else:
            note(stopped_text(reply, record.id))

    key = StopKey(standard_input(), press)
    names = [spec.name for spec in graph.checked.nodes]
    types = [(topic.node, topic.type) for topic in graph.checked.topics.values()]
    if safety_node(types, names) is not None and key.start():
        note("the space bar stops all motion")
    return key


class StopKey:
    """Call back at each press of the space bar; the terminal is as before at the end."""

    def __init__(self, descriptor: int | None, press: Callable[[], None]) -> None:
        self._keyboard, self._press = Keyboard(descriptor), press
        self._end, self._end_in = -1, -1  # a pipe that ends the thread
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> bool:
        """Begin to read keys; return whether there is a terminal."""
        self._keyboard.__enter__()
        if not self._keyboard.file_descriptors:
            return False
        self._end, self._end_in = os.pipe()
        self._thread = threading.Thread(target=self._listen, name="palp-stop-key", daemon=True)
        self._thread.start()
        return True

    def stop(self) -> None:
        if self._thread is not None:
            os.write(self._end_in, b"!")
            self._thread.join(1.0)
            os.close(self._end_in)
            os.close(self._end)
            self._thread = None
        self._keyboard.__exit__()

    def _listen(self) -> None:
        while keyboard := self._keyboard.file_descriptors:
            if self._end in select.select([*keyboard, self._end], (), ())[0]:
                return
            if KEY in self._keyboard.read():
                self._press()
