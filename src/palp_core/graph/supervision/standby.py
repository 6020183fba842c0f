"""Processes next to those that have the nodes' parts: successors before a swap, predecessors after it."""

import contextlib
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import ChannelClosed
from palp_core.graph.process.control_messages import Configured, Done, Failed, FromNode, Matched, ToNode
from palp_core.graph.supervision.channel_server import ChannelServer
from palp_core.graph.supervision.class_inspection import (
    INSPECTING,
    InspectClasses,
    Inspected,
    Inspection,
    describe_exit,
)
from palp_core.graph.supervision.fork_server import ChildEvent, ForkServer, Started
from palp_core.graph.supervision.managed_process import ManagedProcess, ProcessLauncher


class Standby:
    """One such process."""

    def __init__(self, number: int, process: ManagedProcess) -> None:
        self.number, self.process = number, process
        self.failure = ""
        self.on_end: Callable[[], None] = lambda: None
        self.has_left = False  # it has reported that its work is done

    def receive(self, message: FromNode) -> None:
        if isinstance(message, Failed):
            self.failure = message.text.removeprefix(f"{self.process.spec.name}: ")
            return
        self.process.configured |= isinstance(message, Configured)
        self.process.matched |= isinstance(message, Matched)
        self.has_left = isinstance(message, Done)
        self.process.replies.append(message)


class Standbys:
    def __init__(
        self,
        server: ForkServer,
        channels: ChannelServer,
        launcher: ProcessLauncher,
    ) -> None:
        self._server, self._channels, self._launcher = server, channels, launcher
        self._count = 0
        self._all: dict[int, Standby] = {}
        self._inspection = Inspection()

    def start(self, spec: NodeSpec, log: Path, *, fresh: bool) -> Standby:
        """Start a process next to the one that has the node's part."""
        self._count += 1
        process = ManagedProcess(spec, log, f"+{self._count}")
        standby = Standby(self._channels.admit(process.place), process)
        self._all[standby.number] = standby
        self._launcher.spawn(process, successor=True, fresh=fresh)
        return standby

    def inspect(self, requests: Sequence[NodeClassRequest], workspace: Path) -> None:
        """Let a child inspect node classes; :attr:`inspected` is set when it has ended."""
        self._inspection = Inspection()
        self._server.send(InspectClasses(list(requests), str(workspace)))

    @property
    def inspected(self) -> list[NodeClass] | None:
        """What the child has found; None while it looks."""
        inspection = self._inspection
        if inspection.status is None:
            return None
        return inspection.answers or [NodeClass(run="", error=inspection.describe_crash())]

    def kill_inspector(self) -> None:
        """Wait for the child no longer, and end it."""
        if self._inspection.pid:
            self._server.signal(self._inspection.pid, signal.SIGKILL)
        self._inspection = Inspection()

    def exchange(self, index: int, process: ManagedProcess, standby: Standby) -> ManagedProcess:
        """Give a standby a node's part, and the one who had it the standby's; return the new one."""
        self._channels.exchange(index, standby.number)
        new, standby.process = standby.process, process
        return new

    def send(self, standby: Standby, message: ToNode) -> None:
        """Send one a message; the end of one that is gone comes from the fork server."""
        with contextlib.suppress(ChannelClosed):
            self._channels.send(standby.number, message)

    def incoming_bytes(self, standby: Standby) -> int:
        """Return the size of the message that one is sending just now; 0 if it sends none."""
        return self._channels.incoming_bytes(standby.number)

    def receive(self, number: int, message: FromNode) -> bool:
        """Take a message from a process; return False if it is none of these."""
        standby = self._all.get(number)
        if standby is not None:
            standby.receive(message)
        return standby is not None

    def on_child_event(self, event: ChildEvent) -> bool:
        """Take news of a process; return False if it is none of these."""
        if isinstance(event, Inspected):
            self._inspection.add(event)
            return True
        if event.name == INSPECTING:
            if isinstance(event, Started):
                self._inspection.pid = event.pid
            elif event.pid == self._inspection.pid:
                self._inspection.status, self._inspection.output = event.status, event.output
            return True
        for number, standby in self._all.items():
            process = standby.process
            if isinstance(event, Started):
                if event.name == process.place and not process.pid:
                    process.pid = event.pid
                    return True
            elif event.pid == process.pid:
                process.ended = True
                for message in self._channels.drain(number):
                    standby.receive(message)
                standby.failure = standby.failure or f"its process {describe_exit(event.status)}"
                del self._all[number]
                standby.on_end()
                return True
        return False

    def kill(self, standby: Standby) -> None:
        """End one at once: it has nothing to lose."""
        if standby.process.pid and not standby.process.ended:
            self._server.signal(standby.process.pid, signal.SIGKILL)

    @property
    def processes(self) -> list[ManagedProcess]:
        return [standby.process for standby in self._all.values()]
