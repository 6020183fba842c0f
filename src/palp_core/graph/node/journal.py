"""Write down what a node consumes, in order, so that it can be driven again to the same outputs."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from palp_core.graph.messages.builtin import Order
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.publisher import PublisherEnd

ORDER_PORT = "_order"
PARAMETERS = "parameters"
OUTSIDE = "outside:"
TRANSITIONS = (Transition.ACTIVATE, Transition.DEACTIVATE, Transition.CLEANUP, Transition.CONFIGURE)
BATCH = 256
SNAPSHOT_INTERVAL_NS = 10_000_000_000


class Journal:
    """What a node has consumed since the last batch.

    Attributes:
        kept: Whether it is published though nothing has subscribed to it.
    """

    kept = True

    def __init__(
        self, publisher: PublisherEnd[Order], sources: list[str], snapshot: Callable[[], bytes]
    ) -> None:
        self._publisher = publisher
        ends = Transition.SHUTDOWN.value
        self._sources = [*(transition.value for transition in TRANSITIONS), ends, PARAMETERS, *sources]
        self.index = {source: i for i, source in enumerate(self._sources)}
        self._begun = self._followed = False
        self._greeted_count = 0
        self._snapshot = snapshot
        self.next_snapshot_ns = SNAPSHOT_INTERVAL_NS
        self.discard()

    def discard(self) -> None:
        self._hand_over = b""
        self.entries: list[tuple[int, int, int, int]] = []
        self._changes: list[str] = []

    def take_snapshot(self, now_ns: int) -> None:
        """Begin a new batch with a snapshot of the node."""
        self.next_snapshot_ns = now_ns + SNAPSHOT_INTERVAL_NS
        if self._is_unread:
            self.discard()
            return
        if not self._begun:  # the node was taken over: its followers go on
            self._begun = True
            self._follow()
        self.flush(now_ns)
        self._hand_over = self._snapshot()

    @property
    def _is_unread(self) -> bool:
        return not (self.kept or self._publisher.greeted_count)

    def serve_follower(self, now_ns: int, *, active: bool) -> None:
        """Wall clock, ten times a second: publish what is new, and a place to start for a new follower."""
        publisher = self._publisher
        if not publisher.has_readers:
            self._followed = False
        elif active and (not self._followed or publisher.greeted_count > self._greeted_count):
            if not self._followed:
                self.discard()
            self._follow()
            self.take_snapshot(now_ns)
        elif self.entries:
            self.flush(now_ns)

    def _follow(self) -> None:
        self._followed, self._greeted_count = True, self._publisher.greeted_count

    def note(self, source: str, epoch: int, sequence: int, now_ns: int) -> None:
        """Add an entry, before the node handles what it names."""
        self.entries.append((self.index[source], epoch, sequence, now_ns))
        if len(self.entries) >= BATCH:
            self.flush(now_ns)

    def note_transition(self, transition: Transition, now_ns: int) -> bool:
        """Add a transition, of which the first configuration is none; return whether to report it."""
        if transition is Transition.ACTIVATE and not self._begun:
            self._begun = True
            if self._publisher.has_readers:
                self._follow()
        if self._begun:
            self.note(transition.value, 0, 0, now_ns)
        return self._begun and transition in TRANSITIONS

    def note_change(self, source: str, change: Mapping[str, Any], now_ns: int) -> None:
        """Add a change of parameters or a call from outside, with what it says."""
        self._changes.append(json.dumps(dict(change)))
        self.note(source, 0, len(self._changes) - 1, now_ns)

    def flush(self, now_ns: int) -> None:
        """Publish the open batch, if there is anything in it, and begin the next one."""
        if not self.entries and not self._hand_over:
            return
        if self._is_unread or (self._publisher.has_readers and not self._followed):
            self.discard()  # a new follower does not know where this begins; it gets a place to start
            return
        source, epoch, sequence, at_ns = zip(*self.entries, strict=True) if self.entries else ((),) * 4
        batch = Order(
            stamp_ns=now_ns,
            sources=self._sources,
            source=list(source),
            epoch=list(epoch),
            sequence=list(sequence),
            now_ns=list(at_ns),
            changes=self._changes,
            hand_over=self._hand_over,
        )
        self.discard()
        self._publisher.put(batch)
