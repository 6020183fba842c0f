"""What a node's process publishes on the node's own inputs: messages that it is given from outside."""

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import PLAIN_DATA, Frame, Kind, quick_header
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.transport.reorder_buffer import ReorderBuffer

_NONE = (-1, 0)


class OwnMessages:
    """Hands them to the node as soon as they are published.

    They come through the socket as well, as to every reader, and are passed over there. What is not next in
    its order is taken only then.

    Args:
        edges: By topic, what takes a message that is next in its order the short way.
        arrive: Takes a frame, and when it came.
        is_full: Tells whether so much waits for the node that nothing more is to be taken in.
    """

    def __init__(
        self,
        edges: Mapping[bytes, tuple[ReorderBuffer, Subscription]],
        arrive: Callable[[bytes, int], None],
        is_full: Callable[[], bool],
    ) -> None:
        self._edges, self._arrive, self._is_full = edges, arrive, is_full
        self._published: deque[bytes] = deque()
        self._had: dict[str, tuple[int, int]] = {}

    def watch(self, out: PublisherEnd[Any]) -> None:
        """Take note of what is sent on a topic from now on."""
        out.send = partial(self._note, out.send)

    def _note(self, send: Callable[[bytes], None], raw: bytes) -> None:
        send(raw)
        self._published.append(raw)

    def take(self) -> None:
        """Hand on what has been published since; to be called between two handlers."""
        while self._published:
            raw = self._published.popleft()
            end = raw.find(0)
            edge = self._edges.get(raw[:end])
            if edge is None:
                continue
            buffer = edge[0]
            head, epoch, sequence, _, _ = quick_header(raw, end + 1)
            is_next = head == PLAIN_DATA and sequence == buffer.next and epoch == buffer.epoch
            if is_next and not self._is_full():
                self._arrive(raw, monotonic_ns())
                self._had[buffer.topic] = epoch, sequence

    def had(self, frame: Frame) -> bool:
        """Tell whether a frame from the socket has been handed on already."""
        return frame.kind == Kind.DATA and (frame.epoch, frame.sequence) <= self._had.get(frame.topic, _NONE)
