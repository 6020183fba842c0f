"""The sending side of one process: where its nodes publish, and where they answer requests."""

import select
from collections.abc import Callable

import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.transport.publisher_socket import PublisherSocket
from palp_core.graph.transport.request_server import MOST_AT_ONCE, RequestServer

LOOK_NS = 10_000_000
"""How often to look, at most, whether sending has swallowed a signal: looking costs a fifth of a message."""

_REFUSE_S = 0.05
"""How soon a request is refused that comes while the readers leave."""


class NodeSockets:
    """A publishing and an answering socket, looked after by one loop.

    Attributes:
        file_descriptors: Become readable when :meth:`poll` has something to do.
    """

    def __init__(self, publish_endpoint: str, serve_endpoint: str) -> None:
        self.endpoints = publish_endpoint, serve_endpoint
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.publisher = PublisherSocket(self.context, publish_endpoint)
        self.requests = RequestServer(self.context, serve_endpoint)
        self.file_descriptors = self.publisher.file_descriptor, self.requests.file_descriptor
        self._signalled, self._look_ns = True, 0

    def note_signal(self) -> None:
        """Take note that a descriptor was readable."""
        self.publisher.poll_pending = self._signalled = True

    def pending(self) -> bool:
        """Return whether :meth:`poll` may have work, whatever the descriptors show."""
        return self.publisher.poll_pending or self.requests.poll_pending

    def due(self) -> bool:
        """Return whether to :meth:`poll`: at once after a signal or a reply, now and then after sending."""
        poll_pending = self.publisher.poll_pending and (self._signalled or monotonic_ns() >= self._look_ns)
        return poll_pending or self.requests.poll_pending

    def poll(self, most: int = MOST_AT_ONCE, on_deferred: Callable[[], None] = lambda: None) -> None:
        """Answer requests and greet new subscribers, without waiting; what is beyond so many is pending."""
        self.publisher.poll_pending = self.requests.poll_pending = self._signalled = False
        self._look_ns = monotonic_ns() + LOOK_NS
        self.requests.poll(most, on_deferred)
        self.publisher.poll()

    def wait_until_unread(self, patience_ns: int, ends: int) -> None:
        """Wait until no reader is left, and refuse requests meanwhile."""
        until_ns = monotonic_ns() + patience_ns
        self.poll()
        while self.publisher.readers:
            left_ns = until_ns - monotonic_ns()
            self.requests.reject_with_retry()
            wait_s = max(min(left_ns / 1e9, _REFUSE_S), 0.0)
            ready = select.select((*self.file_descriptors, ends), (), (), wait_s)[0]
            if left_ns <= 0 or ends in ready:
                break
            self.poll()
        self.requests.reject_with_retry()

    def close(self) -> None:
        self.context.destroy(linger=200)
