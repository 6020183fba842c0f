"""A node on the wall clock writes itself down at each message by which a checkpoint is due.

No clock decides where: a reader does so before it handles the message, the publisher when the handler that
has published it is done. So what all of them have done before it is in the checkpoint, and nothing of what
comes after.
"""

from collections.abc import Callable
from typing import Any

from palp_core.graph.node.executor import Executor
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.process import checkpoint


class Keeping:
    """Writes one node down.

    Args:
        say: Takes the sequence of the message and the node, written down.
    """

    def __init__(self, executor: Executor, name: str, say: Callable[[int, bytes], None]) -> None:
        self._executor, self._say = executor, say
        self._published = 0
        for subscription in executor.ends.subscriptions.get(name, ()):
            subscription.handler = self._before(subscription)
        if (out := executor.ends.publishers.get(name)) is not None:
            self._watch(out)

    def _before(self, subscription: Subscription) -> Callable[..., None]:
        handle = subscription.handler

        def keep_and_handle(node: Any, message: Any) -> None:
            self._say(subscription.account.sequence, checkpoint.keep(self._executor))
            handle(node, message)

        keep_and_handle.__name__ = handle.__name__
        return keep_and_handle

    def _watch(self, out: PublisherEnd[Any]) -> None:
        noted = out.note

        def note(epoch: int, sequence: int) -> None:
            if noted is not None:
                noted(epoch, sequence)
            self._published = sequence

        out.note = note

    def turn(self) -> None:
        """Between two handlers: write the node down if it has published the message."""
        if self._published:
            sequence, self._published = self._published, 0
            self._say(sequence, checkpoint.keep(self._executor))
