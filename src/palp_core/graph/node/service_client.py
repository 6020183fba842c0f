"""The asking end of a service: what is unanswered, when to ask again, when to give up."""

from collections.abc import Callable
from typing import Any

import msgspec

from palp_core.graph.messages.message import Message
from palp_core.graph.node.owner import Owner
from palp_core.graph.node.publisher import PublisherEnd


class Pending(msgspec.Struct):
    """One call on its way.

    Attributes:
        sequence: Of the request, and of its reply.
        due_ns: When this try is over.
        tries_left: How often the request may still be sent again.
        frame: The request as it was sent.
    """

    sequence: int
    due_ns: int
    tries_left: int
    frame: bytes


class ClientEnd:
    """Sends requests and keeps each until its reply comes; rings like an alarm when one is overdue.

    Args:
        name: Of the client's port.
        publisher: Where requests go.
        timeout_ns: Length of one try.
        retries: How often a request is sent again.
        owner: Whose time it is.
        give_up: Is told how many calls remain unanswered after their last try.
    """

    def __init__(
        self,
        name: str,
        publisher: PublisherEnd[Any],
        timeout_ns: int,
        retries: int,
        owner: Owner,
        give_up: Callable[[int], None],
    ) -> None:
        self.name = name
        self.pending: list[Pending] = []
        self._publisher = publisher
        self._timeout_ns = timeout_ns
        self._retries = retries
        self._owner = owner
        self._give_up = give_up

    def call(self, request: Message) -> None:
        """Send a request and return at once; the reply arrives at ``@on(client)``."""
        self._publisher.publish(request)
        due_ns = self._owner.now_ns() + self._timeout_ns
        sent = self._publisher.history[-1]
        self.pending.append(Pending(self._publisher.sequence, due_ns, self._retries, sent))

    def settle(self, sequence: int) -> bool:
        """Take a reply; return False if nothing waits for it (any more)."""
        for i, pending in enumerate(self.pending):
            if pending.sequence == sequence:
                del self.pending[i]
                return True
        return False

    @property
    def due_ns(self) -> int | None:
        """When the first unanswered call is overdue."""
        return min((pending.due_ns for pending in self.pending), default=None)

    def activate(self, now_ns: int) -> None:
        """Forget unanswered calls at activation."""
        self.pending.clear()

    def tick(self) -> int:
        """Send what is overdue again, or give it up; return how many calls were given up."""
        now_ns = self._owner.now_ns()
        given_up = [p for p in self.pending if p.due_ns <= now_ns and not p.tries_left]
        self.pending = [p for p in self.pending if p not in given_up]
        for pending in self.pending:
            if pending.due_ns <= now_ns:
                pending.tries_left -= 1
                pending.due_ns = now_ns + self._timeout_ns
                self._owner.resend(pending.frame)
        if given_up:
            self._give_up(len(given_up))
        return len(given_up)

    def handle(self) -> None:
        """All is done in :meth:`tick`: the node hears of calls given up by their event."""

    def retime(self, now_ns: int) -> None:
        """Calls have no rate."""

    def resume(self, pending: list[Pending]) -> None:
        """Continue a predecessor's calls."""
        self.pending = list(pending)
