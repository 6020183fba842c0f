"""The asking end of a service: what is unanswered, when to ask again, when to give up."""

from typing import Any, Generic, TypeVar

import msgspec

from palp_core.graph.messages.message import Message
from palp_core.graph.node.context import NodeContext
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd
from palp_core.graph.node.timers import TimedEnd

Request = TypeVar("Request", bound=Message)


class Pending(msgspec.Struct):
    sequence: int
    due_ns: int
    tries_left: int  # how often the request may still be sent again
    frame: bytes


class ClientEnd(TimedEnd, Generic[Request]):
    """Sends requests and keeps each until its reply comes; due when one is overdue."""

    given_up: EventEnd  # counts calls that remain unanswered after their last try

    def __init__(
        self,
        port: str,
        context: NodeContext,
        publisher: PublisherEnd[Any],
        timeout_ns: int,
        retries: int,
    ) -> None:
        super().__init__(f"timeout:{port}", port, context)
        self.pending: list[Pending] = []
        self._publisher, self._timeout_ns, self._retries = publisher, timeout_ns, retries

    def call(self, request: Request) -> None:
        """Send a request and return at once; the reply arrives at ``@on(client)``."""
        self._publisher.publish(request)
        due_ns = self._context.now_ns() + self._timeout_ns
        sent = self._publisher.history[-1]
        self._keep([*self.pending, Pending(self._publisher.sequence, due_ns, self._retries, sent)])

    def _keep(self, pending: list[Pending]) -> None:
        self.pending = pending
        self.due_ns = min((call.due_ns for call in pending), default=None)

    def complete(self, sequence: int) -> bool:
        """Take a reply; return False if nothing waits for it (any more)."""
        waiting = [call for call in self.pending if call.sequence != sequence]
        was_pending = len(waiting) < len(self.pending)
        self._keep(waiting)
        return was_pending

    def activate(self, now_ns: int) -> None:
        self._keep([])

    def tick(self) -> int:
        """Send what is overdue again, or give it up; return how many calls were given up."""
        now_ns = self._context.now_ns()
        kept = [call for call in self.pending if call.tries_left or call.due_ns > now_ns]
        given_up = len(self.pending) - len(kept)
        for call in kept:
            if call.due_ns <= now_ns:
                call.tries_left -= 1
                call.due_ns = now_ns + self._timeout_ns
                self._context.resend(call.frame)
        self._keep(kept)
        self.given_up.count(given_up, now_ns)
        return given_up

    def resume(self, pending: list[Pending]) -> None:
        self._keep(list(pending))
