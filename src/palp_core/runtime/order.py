"""Write down what a node consumes, in order, so that it can be driven again to the same outputs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from palp_core.runtime.builtin import Order
from palp_core.runtime.outlet import Outlet

__all__ = ["ACTIVATE", "ORDER_PORT", "PARAMETERS", "OrderLog"]

ORDER_PORT = "_order"
ACTIVATE = "activate"
PARAMETERS = "parameters"
BATCH = 256
SNAPSHOT_INTERVAL_NS = 10_000_000_000


class OrderLog:
    """Collects entries and publishes one :class:`Order` per batch.

    Args:
        outlet: Where batches go.
        sources: Everything that the node can consume.
        snapshot: Returns the node's encoded hand-over, without inbox and histories.
    """

    def __init__(self, outlet: Outlet[Order], sources: list[str], snapshot: Callable[[], bytes]) -> None:
        self._outlet = outlet
        self._sources = sources
        self._index = {source: i for i, source in enumerate(sources)}
        self._snapshot = snapshot
        self._next_snapshot_ns = SNAPSHOT_INTERVAL_NS
        self._clear()

    def _clear(self) -> None:
        self._hand_over = b""
        self._source: list[int] = []
        self._epoch: list[int] = []
        self._sequence: list[int] = []
        self._now_ns: list[int] = []
        self._changes: list[str] = []

    def begin(self, now_ns: int) -> None:
        """Begin a new batch with a snapshot of the node."""
        self.flush(now_ns)
        self._hand_over = self._snapshot()
        self._next_snapshot_ns = now_ns + SNAPSHOT_INTERVAL_NS

    def prepare(self, now_ns: int) -> None:
        """Take a snapshot if one is due; to be called before anything is consumed or accounted for."""
        if now_ns >= self._next_snapshot_ns:
            self.begin(now_ns)

    def note(self, source: str, epoch: int, sequence: int, now_ns: int) -> None:
        """Add an entry, before the node handles what it names."""
        self._source.append(self._index[source])
        self._epoch.append(epoch)
        self._sequence.append(sequence)
        self._now_ns.append(now_ns)
        if len(self._source) >= BATCH:
            self.flush(now_ns)

    def note_change(self, changes: Mapping[str, Any], now_ns: int) -> None:
        """Add a change of parameters."""
        self._changes.append(json.dumps(dict(changes)))
        self.note(PARAMETERS, 0, len(self._changes) - 1, now_ns)

    def flush(self, now_ns: int) -> None:
        """Publish the open batch, if there is anything in it, and begin the next one."""
        if not self._source and not self._hand_over:
            return
        batch = Order(
            stamp_ns=now_ns,
            sources=self._sources,
            source=self._source,
            epoch=self._epoch,
            sequence=self._sequence,
            now_ns=self._now_ns,
            changes=self._changes,
            hand_over=self._hand_over,
        )
        self._clear()
        self._outlet.put(batch)
