"""The supervisor's end of the fork server."""

from __future__ import annotations

import select
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.loading import NodeProcess
from palp_core.graph.process.channel import ChannelClosed, MessageChannel
from palp_core.graph.supervision.fork_server import (
    ChildEvent,
    Exited,
    InspectClasses,
    Request,
    Signal,
    Spawn,
    Started,
)
from palp_core.graph.supervision.fork_start import ServerProcess, start_fork_server
from palp_core.graph.supervision.interrupt import Interrupt

CLOSE_TIMEOUT_S = 5.0


class ForkServer:
    """A running fork server; closing it ends every process it has started.

    Args:
        interrupt: Raises when the user wants the end while node classes are looked at.
        started: Its process, if it was started before.
    """

    def __init__(self, interrupt: Interrupt | None = None, started: ServerProcess | None = None) -> None:
        self._interrupt = interrupt
        self._process, line = started or start_fork_server()
        self._line = MessageChannel(line, msgspec.msgpack.Decoder(ChildEvent))

    @property
    def descriptor(self) -> int:
        """Becomes readable when there is news."""
        return self._line.socket.fileno()

    @property
    def pid(self) -> int:
        """Process id of the fork server."""
        return self._process.pid

    def send(self, request: Request) -> None:
        """Send a request.

        Raises:
            GraphError: The fork server is gone.
        """
        try:
            self._line.send(request)
        except ChannelClosed as error:
            raise GraphError(f"the fork server (process {self.pid}) is gone: {error}") from error

    def spawn(self, process: NodeProcess, log: str) -> None:
        """Start a node's process; news of it follow."""
        self.send(Spawn(process, log))

    def signal(self, pid: int, number: signal.Signals) -> None:
        """Send a signal to a child."""
        self.send(Signal(pid, int(number)))

    def read_events(self) -> list[ChildEvent]:
        """Wait for news and return what there is.

        Raises:
            GraphError: The fork server is gone.
        """
        try:
            self._line.fill()
        except ChannelClosed as error:
            raise GraphError(
                f"the fork server (process {self.pid}) has ended; its nodes ended with it"
            ) from error
        found = []
        while self._line.buffered():
            found.append(self._line.receive())
        return found

    def inspect_classes(
        self, requests: Sequence[NodeClassRequest], workspace: Path, folder: Path
    ) -> list[NodeClass]:
        """Let a forked child import node classes and say what they are.

        Raises:
            GraphError: The child died before it could answer.
            Interrupted: The user asked for the end.
        """
        answer = folder / "descriptions"
        self.send(InspectClasses(list(requests), str(workspace), str(answer)))
        while True:
            if self._interrupt is not None:
                select.select((self.descriptor, self._interrupt.descriptor), (), ())
                self._interrupt.check()
            for item in self.read_events():
                if isinstance(item, Started):
                    continue
                assert isinstance(item, Exited)
                if not answer.exists():
                    said = Path(f"{answer}.log").read_text(errors="replace").strip().splitlines()[-3:]
                    raise GraphError(
                        f"looking at the node classes ended with status {item.status}: " + " | ".join(said)
                    )
                inspected = decode_any(list[NodeClass], answer.read_bytes())
                answer.unlink()
                return inspected

    def wake(self) -> None:
        """Let it go on, should it have been stopped: the end needs it."""
        self._process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End every child and the server; returns when they are gone."""
        self._line.close()
        try:
            self._process.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:  # stopped, perhaps; its death is that of its children
            self._process.kill()
            self._process.wait()
