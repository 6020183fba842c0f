"""Quality-of-service events of a port: what a node can handle with ``@on_event(port)``."""

from collections.abc import Callable

import msgspec

from palp_core.graph.messages.qos import EventKind
from palp_core.graph.node.owner import Owner

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
    """Something that an edge promised and did not keep.

    Attributes:
        kind: ``deadline``: nothing came within the deadline; ``lifespan``: a message was too old and was
            dropped; ``liveliness``: the publisher fell silent for longer than its lease (odd counts) or is
            back (even ones); ``message_lost``: a gap that nobody could fill; ``message_repeated``: so many
            in a row were here already, which is said and handed to nobody; ``call_timeout``: a service did
            not answer, after all retries; ``reader_overrun``, of an output: readers have lost messages, which
            is said at most once a second.
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
        """What happened, in words."""
        if self.kind == "liveliness":
            what = "its publisher has fallen silent" if self.total_count % 2 else "its publisher is back"
            return f"input '{self.port}' ({self.topic}): {what}"
        where = _WHERE.get(self.kind, "input")
        return f"{where} '{self.port}' ({self.topic}): {_TEXT[self.kind]} ({self.total_count} in all)"


def is_worth_saying(event: QosEvent) -> bool:
    """Tell whether to say an event aloud: the first few, then each time their number has doubled."""
    before, now = event.total_count - event.count_change, event.total_count
    if event.kind in ("liveliness", "reader_overrun"):  # the latter comes at most once a second
        return True
    return now <= FIRST_FEW or now.bit_length() > before.bit_length()


class EventEnd:
    """Rings like an alarm when an edge does not keep what it promised, so that a replay can ring it again.

    Args:
        kind: Of its events.
        port: Name of the input or client.
        topic: What it reads.
        owner: Whose time it is.
        handle: Takes each event.
    """

    def __init__(
        self, kind: EventKind, port: str, topic: str, owner: Owner, handle: Callable[[QosEvent], None]
    ) -> None:
        self.kind = kind
        self.name = f"{kind}:{port}"
        self.due_ns: int | None = None
        self.period_ns = 0
        self._port = port
        self._topic = topic
        self._owner = owner
        self._handle = handle
        self._pending = 0
        self._total = 0
        self._said = 0

    def activate(self, now_ns: int) -> None:
        """Nothing is due at activation."""
        self.due_ns = None

    def expect(self, due_ns: int | None, period_ns: int = 0) -> None:
        """Ring at that time unless told otherwise, and then every period; None: nothing is expected."""
        self.due_ns, self.period_ns = due_ns, period_ns

    def count(self, change: int, now_ns: int) -> None:
        """Ring now: it has happened so many more times."""
        if change > 0:
            self._pending += change
            self.due_ns = now_ns

    def tick(self) -> int:
        """Ring; return the total count. Periods that passed meanwhile are counted and not rung one by one."""
        change, self._pending = self._pending or 1, 0
        if self.period_ns and self.due_ns is not None:
            change += max((self._owner.now_ns() - self.due_ns) // self.period_ns, 0)
            self.due_ns += change * self.period_ns
        else:
            self.due_ns = None
        self._total += change
        return self._total

    def recall(self, total: int) -> None:
        """Set what the next :meth:`handle` reports, from a record."""
        self._total = total
        self._pending = 0

    def handle(self) -> None:
        """Hand the event to the node."""
        change, self._said = self._total - self._said, self._total
        self._handle(
            QosEvent(
                kind=self.kind,
                port=self._port,
                topic=self._topic,
                total_count=self._total,
                count_change=change,
            )
        )

    def retime(self, now_ns: int) -> None:
        """Events have no rate."""

    def resume(self, total: int) -> None:
        """Continue a predecessor's count."""
        self._total = self._said = total
        self._pending, self.due_ns = 0, None

    @property
    def total(self) -> int:
        """How often it has happened."""
        return self._total
