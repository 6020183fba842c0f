"""The supervisor's ends of all nodes' lines: who is connected, and what they say."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from palp_core.runtime.link import FromNode, Hello, Link, LinkClosed, ToNode, supervisor_end

__all__ = ["Switchboard"]


class Switchboard:
    """Lines to named nodes, numbered by their place in the list.

    Args:
        path: Unix socket on which nodes report.
        names: Nodes that may connect; whoever else does is turned away.
        others: Descriptors of others to wait for in the same place.
    """

    def __init__(self, path: Path, names: Sequence[str], others: Iterable[int]) -> None:
        self._names = list(names)
        self._links: dict[int, Link[FromNode]] = {}
        self._strangers: dict[int, Link[FromNode]] = {}
        self._index_of: dict[int, int] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        self._listener.listen(len(self._names) + 8)
        self._poll = select.poll()
        for descriptor in (self._listener.fileno(), *others):
            self._poll.register(descriptor, select.POLLIN)

    def connected(self, index: int) -> bool:
        """Tell whether a node's line is open."""
        return index in self._links

    def send(self, index: int, message: ToNode) -> None:
        """Say something to a node.

        Raises:
            LinkClosed: Its line is not open.
        """
        if index not in self._links:
            raise LinkClosed("no line")
        self._links[index].send(message)

    def wait(self, timeout_s: float) -> tuple[list[tuple[int, FromNode]], set[int]]:
        """Wait until somebody says something; return what nodes said, and the ready ones of the others."""
        heard: list[tuple[int, FromNode]] = []
        others: set[int] = set()
        for descriptor, _ in self._poll.poll(timeout_s * 1e3):
            if descriptor in self._index_of:
                index = self._index_of[descriptor]
                heard += [(index, message) for message in self._receive(index)]
            elif descriptor == self._listener.fileno():
                connection, _ = self._listener.accept()
                self._strangers[connection.fileno()] = supervisor_end(connection)
                self._poll.register(connection.fileno(), select.POLLIN)
            elif descriptor in self._strangers:
                heard += self._welcome(descriptor)
            else:
                others.add(descriptor)
        return heard, others

    def _receive(self, index: int) -> Iterator[FromNode]:
        """Yield what a node has said; hang up at the end of its line."""
        link = self._links[index]
        try:
            yield link.receive()
            while link.buffered():
                yield link.receive()
        except LinkClosed:
            self.hang_up(index)  # the fork server will say how it ended

    def last_words(self, index: int) -> Iterator[FromNode]:
        """Yield all that is still in the line of a node that has ended."""
        while index in self._links:
            yield from self._receive(index)

    def _welcome(self, descriptor: int) -> list[tuple[int, FromNode]]:
        link = self._strangers.pop(descriptor)
        self._poll.unregister(descriptor)
        try:
            hello = link.receive()
        except LinkClosed:
            return []
        if not isinstance(hello, Hello) or hello.name not in self._names:
            link.close()
            return []
        index = self._names.index(hello.name)
        self._links[index], self._index_of[descriptor] = link, index
        self._poll.register(descriptor, select.POLLIN)
        return [(index, message) for message in self._receive(index)] if link.buffered() else []

    def hang_up(self, index: int) -> None:
        """Close a node's line."""
        link = self._links.pop(index, None)
        if link is not None:
            self._index_of.pop(link.socket.fileno(), None)
            self._poll.unregister(link.socket.fileno())
            link.close()

    def close(self) -> None:
        """Close every line."""
        for index in list(self._links):
            self.hang_up(index)
        for link in self._strangers.values():
            link.close()
        self._listener.close()
