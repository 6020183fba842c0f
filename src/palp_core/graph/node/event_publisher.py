"""What happens to a node, said in its log, on its hidden topic and to whoever runs it."""

import json
import logging
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.builtin import NodeEvent
from palp_core.graph.node.owner import Owner
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import QosEvent, is_worth_saying

EVENTS_PORT = "_events"


class EventPublisher:
    """Publishes events, each kind at a rate that cannot flood.

    Args:
        publisher: Where events are published.
        log: The node's log.
        owner: Whose time it is.

    Attributes:
        rejected_count: Frames that were not what an edge carries.
        report: Is told of each quality-of-service event worth saying.
    """

    def __init__(self, publisher: PublisherEnd[NodeEvent], log: logging.Logger, owner: Owner) -> None:
        self.rejected_count = 0
        self.report: Callable[[QosEvent], None] = lambda _: None
        self._publisher = publisher
        self._log = log
        self._owner = owner

    def publish(self, kind: str, text: str, data: Mapping[str, Any]) -> None:
        """Publish an event."""
        now_ns = self._owner.now_ns()
        self._publisher.put(NodeEvent(stamp_ns=now_ns, kind=kind, text=text, data=json.dumps(dict(data))))

    def publish_qos_event(self, event: QosEvent) -> None:
        """Say that an edge did not keep its promise."""
        if is_worth_saying(event):
            self._log.warning("%s", event.text)
            self.publish(event.kind, event.text, msgspec.to_builtins(event))
            self.report(event)

    def reject(self, error: SchemaMismatch) -> None:
        """Count a frame that is not what an edge carries; say so the 1st, 2nd, 4th, 8th ... time."""
        self.rejected_count += 1
        if self.rejected_count & (self.rejected_count - 1) == 0:
            self._log.warning("rejected %s; the latest: %s", counted(self.rejected_count, "frame"), error)
