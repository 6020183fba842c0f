"""A node on the wall clock writes itself down at each message by which a checkpoint is due, not at a time.

So what all nodes have done before that message is in the checkpoint, and nothing of what comes after.
"""

from collections.abc import Callable
from typing import Any

from palp_core.errors import SchemaMismatch, in_words
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.subscription import Subscription


class NodeCheckpointer:
    """Writes one node down."""

    def __init__(self, executor: Executor, topic: str, keep: Callable[[int, bytes], None]) -> None:
        self._executor, self._keep = executor, keep
        for subscription in executor.ends.subscriptions.get(topic, ()):
            subscription.handler = self._before(subscription)
        self._out = executor.ends.publishers.get(topic)
        self._kept = 0

    def _before(self, subscription: Subscription) -> Callable[..., None]:
        handle = subscription.handler

        def keep_and_handle(node: Any, message: Any) -> None:
            self._write_down(subscription.account.sequence)
            handle(node, message)

        keep_and_handle.__name__ = handle.__name__
        return keep_and_handle

    def _write_down(self, sequence: int) -> None:
        self._keep(sequence, encode_any(self._executor.snapshot()))

    def turn(self) -> None:
        """Between two handlers: write the node down if it has published the message."""
        if self._out is not None and self._out.sequence != self._kept:
            self._kept = self._out.sequence
            self._write_down(self._kept)


def restore(executor: Executor, data: bytes) -> None:
    """Give a node that is about to be activated the state and randomness it had."""
    try:
        hand_over = decode_any(HandOver, data)
    except (ValueError, TypeError) as error:
        raise SchemaMismatch(f"the checkpoint is from another version: {in_words(error)}") from error
    executor.restore(hand_over)
