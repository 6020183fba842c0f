"""Quality-of-service events of a port: what a node can handle with ``@on_event(port)``."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.builtin import NodeEvent
from palp_core.graph.messages.qos import EventKind, Qos
from palp_core.graph.node.context import NodeContext
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.spec import topic
from palp_core.graph.node.timers import TimedEnd

EVENTS_PORT = "_events"

_TEXT: dict[EventKind, str] = {
    "deadline": "no message within its deadline",
    "lifespan": "a message was older than its lifespan and was dropped",
    "message_lost": "messages were lost",
    "message_repeated": "messages come that were here already, or of a process that is over, and are dropped",
    "call_timeout": "a call was not answered",
    "reader_overrun": "readers have lost messages for good: they take up fewer than are published",
}
_WHERE: dict[EventKind, str] = {"call_timeout": "client", "reader_overrun": "output"}
FIRST_FEW = 8


class QosEvent(msgspec.Struct, frozen=True, kw_only=True):
    """A broken QoS policy of an edge.

    Attributes:
        kind: ``deadline``: nothing came within the deadline; ``lifespan``: a message was too old and was
            dropped; ``liveliness``: the publisher fell silent for longer than its lease (odd counts) or is
            back (even ones); ``message_lost``: a gap that remains; ``message_repeated``: so many in a row
            were here already, which is reported and reaches no handler; ``call_timeout``: a service did not
            answer, after all retries; ``reader_overrun``, of an output: readers have lost messages, reported
            at most once a second.
        port: Name of the input, output or client.
        topic: What it reads or publishes.
        total_count: How often it has happened since the node began; lost messages and calls count each.
        count_change: How much the total grew with this event.
    """

    kind: EventKind
    port: str
    topic: str
    total_count: int
    count_change: int

    @property
    def text(self) -> str:
        """What happened, as a sentence."""
        if self.kind == "liveliness":
            what = "its publisher has fallen silent" if self.total_count % 2 else "its publisher is back"
            return f"input '{self.port}' ({self.topic}): {what}"
        where = _WHERE.get(self.kind, "input")
        return f"{where} '{self.port}' ({self.topic}): {_TEXT[self.kind]} ({self.total_count} in all)"


def is_reported(event: QosEvent) -> bool:
    """Return whether to report an event: the first few are, then each time their number has doubled."""
    before, now = event.total_count - event.count_change, event.total_count
    if event.kind in ("liveliness", "reader_overrun"):  # the latter comes at most once a second
        return True
    return now <= FIRST_FEW or now.bit_length() > before.bit_length()


class EventPublisher:
    """Reports what happens to a node, at rates that cannot flood: log and hidden topic."""

    def __init__(self, context: NodeContext, send: Callable[[bytes], None]) -> None:
        self.publisher = PublisherEnd(
            topic(context.name, EVENTS_PORT), NodeEvent, Qos(depth=100), context.epoch, context, send
        )
        self.rejected_count = 0
        self._context = context

    def publish(self, kind: str, text: str, data: Mapping[str, Any]) -> None:
        now_ns = self._context.now_ns()
        self.publisher.put(NodeEvent(stamp_ns=now_ns, kind=kind, text=text, data=json.dumps(dict(data))))

    def publish_qos_event(
        self, kind: EventKind, port: str, source: str, total_count: int, count_change: int = 1
    ) -> QosEvent:
        event = QosEvent(
            kind=kind, port=port, topic=source, total_count=total_count, count_change=count_change
        )
        if is_reported(event):
            self._context.log.warning("%s", event.text)
            self.publish(event.kind, event.text, msgspec.to_builtins(event))
        return event

    def reject(self, error: SchemaMismatch) -> None:
        """Count a frame that is not what an edge carries; log the 1st, 2nd, 4th, 8th ... of them."""
        self.rejected_count += 1
        if self.rejected_count & (self.rejected_count - 1) == 0:
            count = counted(self.rejected_count, "frame")
            self._context.log.warning("rejected %s; the latest: %s", count, error)


class EventEnd(TimedEnd):
    """Rings like an alarm when an edge did not keep what it promised, so that a replay can ring it again."""

    def __init__(
        self,
        kind: EventKind,
        port: str,
        source: str,
        context: NodeContext,
        events: EventPublisher,
        handler: Callable[[Any, QosEvent], None] | None,
    ) -> None:
        super().__init__(f"{kind}:{port}", port, context, handler)
        self.kind = kind
        self.period_ns = self.total = 0
        self._source, self._events = source, events
        self._pending = self._handled = 0

    def expect(self, due_ns: int | None, period_ns: int = 0) -> None:
        """Ring at that time unless another is set, and then every period; None: nothing is expected."""
        self.due_ns, self.period_ns = due_ns, period_ns

    def count(self, change: int, now_ns: int) -> None:
        if change > 0:
            self._pending += change
            self.due_ns = now_ns

    def tick(self) -> int:
        """Return the total count; periods that passed meanwhile are counted and not rung one by one."""
        change, self._pending = self._pending or 1, 0
        if self.period_ns and self.due_ns is not None:
            change += max((self._context.now_ns() - self.due_ns) // self.period_ns, 0)
            self.due_ns += change * self.period_ns
        else:
            self.due_ns = None
        self.total += change
        return self.total

    def recall(self, total: int) -> None:
        """Set what the next :meth:`handle` reports, from a record."""
        self.total, self._pending = total, 0

    def handle(self) -> None:
        change, self._handled = self.total - self._handled, self.total
        event = self._events.publish_qos_event(self.kind, self.port, self._source, self.total, change)
        if self.handler is not None:
            self.handler(self._context.node, event)

    def resume(self, total: int) -> None:
        self.total = self._handled = total
        self._pending, self.due_ns = 0, None
