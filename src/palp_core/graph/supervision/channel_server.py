"""The supervisor's ends of all nodes' channels: who is connected, and what they say.

Nothing here waits for a node: one that is stopped in the middle of a message must not stop the supervisor.
"""

import contextlib
import select
import socket
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path

import msgspec

from palp_core.graph.process.channel import ChannelClosed, MessageChannel
from palp_core.graph.process.control_messages import FromNode, Hello, ToNode, supervisor_end
from palp_core.whole_file import PRIVATE


class ChannelServer:
    """Channels to named nodes, numbered by their place in the list."""

    def __init__(self, path: Path, names: Sequence[str], others: Iterable[int]) -> None:
        self._names = list(names)
        self._channels: dict[int, MessageChannel[FromNode]] = {}
        self._unnamed: dict[int, MessageChannel[FromNode]] = {}
        self._index_of: dict[int, int] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        path.chmod(PRIVATE)  # before it listens
        self._listener.listen(len(self._names) + 8)
        self._handlers: dict[int, Callable[[], None]] = {}
        self._poll = select.poll()
        for descriptor in (self._listener.fileno(), *others):
            self._poll.register(descriptor, select.POLLIN)

    def watch(self, descriptor: int, handle: Callable[[], None]) -> None:
        """Wait for one more of the others, too; ``handle`` is whose turn it is when it can be read."""
        self._handlers[descriptor] = handle
        self._poll.register(descriptor, select.POLLIN)

    def forget(self, descriptor: int) -> None:
        if self._handlers.pop(descriptor, None) is not None:
            self._poll.unregister(descriptor)

    def handlers(self, others: Collection[int]) -> list[Callable[[], None]]:
        """Return whose turn it is, of those that are watched."""
        return [handle for descriptor, handle in self._handlers.items() if descriptor in others]

    def admit(self, name: str) -> int:
        self._names.append(name)
        return len(self._names) - 1

    def exchange(self, first: int, second: int) -> None:
        self._names[first], self._names[second] = self._names[second], self._names[first]
        channels = self._channels.pop(first, None), self._channels.pop(second, None)
        for index, channel in zip((second, first), channels, strict=True):
            if channel is not None:
                self._channels[index] = channel
                self._index_of[channel.socket.fileno()] = index

    def connected(self, index: int) -> bool:
        return index in self._channels

    def send(self, index: int, message: ToNode) -> None:
        """Say something to a node; what its channel cannot take at once leaves during :meth:`wait`."""
        if index not in self._channels:
            raise ChannelClosed("no channel")
        channel = self._channels[index]
        if not channel.post(message):
            self._poll.modify(channel.socket.fileno(), select.POLLIN | select.POLLOUT)

    def incoming_bytes(self, index: int) -> int:
        """Return the size of the message that a node is sending just now; 0 if it sends none."""
        return self._channels[index].incoming_bytes if index in self._channels else 0

    def wait(self, timeout_s: float) -> tuple[list[tuple[int, FromNode]], set[int]]:
        """Wait until something is ready; return nodes' messages, and the ready ones of the others."""
        received: list[tuple[int, FromNode]] = []
        others: set[int] = set()
        for descriptor, events in self._poll.poll(timeout_s * 1e3):
            if descriptor in self._index_of:
                index = self._index_of[descriptor]
                if events & select.POLLOUT:
                    self._flush(index)
                if events & ~select.POLLOUT:
                    received += [(index, message) for message in self._receive(index)]
            elif descriptor == self._listener.fileno():
                connection, _ = self._listener.accept()
                self._unnamed[connection.fileno()] = supervisor_end(connection)
                self._poll.register(connection.fileno(), select.POLLIN)
            elif descriptor in self._unnamed:
                received += self._identify(descriptor)
            else:
                others.add(descriptor)
        return received, others

    def _flush(self, index: int) -> None:
        channel = self._channels[index]
        try:
            if not channel.flush():
                return
        except ChannelClosed:
            pass  # what it still has to say is read first, then its channel ends
        self._poll.modify(channel.socket.fileno(), select.POLLIN)

    def _receive(self, index: int) -> Iterator[FromNode]:
        """Yield a node's messages; disconnect at the end of its channel."""
        channel = self._channels[index]
        try:
            channel.fill(socket.MSG_DONTWAIT)
        except ChannelClosed:
            self.disconnect(index)  # the fork server will say how it ended
        while channel.buffered():
            yield channel.receive()

    def drain(self, index: int) -> Iterator[FromNode]:
        """Yield the last messages of a node that has ended, even if a child of it holds the channel."""
        while index in self._channels:
            yield from self._receive(index)

    def _identify(self, descriptor: int) -> list[tuple[int, FromNode]]:
        """Take a channel whose first words are a node's name into the list; disconnect anybody else."""
        channel = self._unnamed[descriptor]
        hello: FromNode | None = None
        with contextlib.suppress(ChannelClosed, msgspec.MsgspecError):
            channel.fill(socket.MSG_DONTWAIT)
            if not channel.buffered():
                return []
            hello = channel.receive()
        del self._unnamed[descriptor]
        if not isinstance(hello, Hello) or hello.name not in self._names:
            self._poll.unregister(descriptor)
            channel.close()
            return []
        index = self._names.index(hello.name)
        self.disconnect(index)
        self._channels[index], self._index_of[descriptor] = channel, index
        received: list[tuple[int, FromNode]] = []
        while channel.buffered():
            received.append((index, channel.receive()))
        return received

    def disconnect(self, index: int) -> None:
        channel = self._channels.pop(index, None)
        if channel is not None:
            self._index_of.pop(channel.socket.fileno(), None)
            self._poll.unregister(channel.socket.fileno())
            channel.close()

    def close(self) -> None:
        for index in list(self._channels):
            self.disconnect(index)
        for channel in self._unnamed.values():
            channel.close()
        self._listener.close()
