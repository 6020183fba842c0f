"""Write down what a node consumes, in order, so that it can be driven again to the same outputs."""

from __future__ import annotations

from palp_core.runtime.builtin import Order

__all__ = ["OrderLog"]

BATCH = 256
STATE_INTERVAL_NS = 10_000_000_000


class OrderLog:
    """Collects entries and gives out one :class:`Order` per batch."""

    def __init__(self, sources: list[str]) -> None:
        self._sources = sources
        self._index = {source: i for i, source in enumerate(sources)}
        self._state: tuple[int, bytes] | None = None
        self._next_state_ns = 0
        self._clear()

    def _clear(self) -> None:
        self._source: list[int] = []
        self._epoch: list[int] = []
        self._sequence: list[int] = []
        self._now_ns: list[int] = []

    def wants_state(self, now_ns: int) -> bool:
        """Tell whether a state is due: at activation and every 10 s."""
        return now_ns >= self._next_state_ns

    def put_state(self, version: int, state: bytes, now_ns: int) -> Order | None:
        """Begin a new batch with the node's state; return the batch that it closes."""
        closed = self.flush(now_ns)
        self._state = (version, state)
        self._next_state_ns = now_ns + STATE_INTERVAL_NS
        return closed

    def note(self, source: str, epoch: int, sequence: int, now_ns: int) -> bool:
        """Add an entry; return True when the batch is full."""
        self._source.append(self._index[source])
        self._epoch.append(epoch)
        self._sequence.append(sequence)
        self._now_ns.append(now_ns)
        return len(self._source) >= BATCH

    def flush(self, now_ns: int) -> Order | None:
        """Return the open batch and begin the next one; None if there is nothing in it."""
        if not self._source and self._state is None:
            return None
        version, state = self._state or (0, b"")
        batch = Order(
            stamp_ns=now_ns,
            sources=self._sources,
            source=self._source,
            epoch=self._epoch,
            sequence=self._sequence,
            now_ns=self._now_ns,
            state_present=self._state is not None,
            state_version=version,
            state=state,
        )
        self._state = None
        self._clear()
        return batch
