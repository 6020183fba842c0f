"""The parent of every node's process: warm, single-threaded, and the guarantee that no orphan remains.

Both ends of its channel are here: :class:`ForkServer` is the launcher's. It is started by the launcher,
imports what nodes share, and forks on request from its main thread only. It writes down
what its children print. When the launcher's end closes, it brings all children down (SIGTERM, then SIGKILL
after a grace of 0.6 s) and exits. If it is killed itself, the kernel kills its children. What a node has
started goes with the node; what has left the node's process group, with the server, after the same grace.

Run as ``python -m palp_core.graph.supervision.fork_server <descriptor of the channel>``.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.node.spec import RECORDER
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.process.control_messages import Spawn
from palp_core.graph.supervision import class_inspection
from palp_core.graph.supervision.class_inspection import (
    INSPECTING,
    NOT_STARTED,
    OUTPUT_BYTES,
    HeavyImport,
    InspectClasses,
    Inspected,
    Inspection,
    ToRun,
    import_heavy,
    inspect_in_child,
)
from palp_core.graph.supervision.fork_child import (
    adopt_orphans,
    apply_scheduling,
    open_many_files,
    run_child,
)
from palp_core.graph.supervision.fork_start import Fork, ServerProcess, start_fork_server
from palp_core.graph.supervision.interrupt import Interrupt
from palp_core.graph.supervision.logs import LogWriter

GRACE_NS = 600_000_000
RECORDER_GRACE_NS = 12_000_000_000
CLOSE_TIMEOUT_S = 5.0
LIGHT = ("numpy.random", "palp_core.graph.process.main")
"""What every node needs, and nothing of the workspace (a swap could not load it again)."""
NO_PROCESS = 2**31 - 1
"""In place of the id of a process that could not be started: no process has one as high."""


class Signal(ChannelMessage, frozen=True):
    pid: int
    number: int


class Started(ChannelMessage, frozen=True):
    """A child lives; ``name`` is empty for an inspecting child."""

    name: str
    pid: int


class Exited(ChannelMessage, frozen=True):
    """A child is gone and reaped, or could not be started.

    ``status`` is as :func:`os.waitstatus_to_exitcode` gives it, or :data:`NOT_STARTED` and more; ``output``
    is the end of what an inspecting child has printed.
    """

    name: str
    pid: int
    status: int
    output: str = ""


Request = Spawn | InspectClasses | Signal
ChildEvent = Started | Exited | Inspected


class ForkServer:
    """A running fork server; closing it ends every process it has started."""

    def __init__(self, interrupt: Interrupt | None = None, started: ServerProcess | None = None) -> None:
        self._interrupt = interrupt
        self._process, connection = started or start_fork_server()
        self._channel = MessageChannel(connection, msgspec.msgpack.Decoder(ChildEvent | HeavyImport))

    @property
    def descriptor(self) -> int:
        """Becomes readable when a child has started or ended."""
        return self._channel.socket.fileno()

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, request: Request) -> None:
        try:
            self._channel.send(request)
        except ChannelClosed as error:
            raise GraphError(f"the fork server (process {self.pid}) is gone: {error}") from error

    def signal(self, pid: int, number: signal.Signals) -> None:
        self.send(Signal(pid, int(number)))

    def read_events(self) -> list[ChildEvent]:
        """Wait for events of children and return what there is; import what is announced."""
        try:
            self._channel.fill()
        except ChannelClosed as error:
            raise GraphError(
                f"the fork server (process {self.pid}) has ended; its nodes ended with it"
            ) from error
        found = []
        while self._channel.buffered():
            item = self._channel.receive()
            if isinstance(item, HeavyImport):
                import_heavy(item.module)
            else:
                found.append(item)
        return found

    def inspect_classes(
        self, requests: Sequence[NodeClassRequest], workspace: Path, *, to_run: ToRun = "forked"
    ) -> list[NodeClass]:
        """Let a forked child import node classes and describe them.

        If one ends the child, its error says so, and another child goes on with the next. If one does not
        come to an end, that is the error of all that are left: they may well wait for the same module.
        """
        found: list[NodeClass] = []
        ended: dict[str, str] = {}  # what ended a child once is not imported again
        while len(found) < len(requests):
            request = requests[len(found)]
            if request.run in ended:
                found.append(NodeClass(run=request.run, error=ended[request.run]))
                continue
            self.send(InspectClasses(list(requests[len(found) :]), str(workspace), to_run))
            inspection = Inspection()
            self._finish(inspection)
            found += inspection.answers
            if len(found) == len(requests):
                break
            if inspection.timed_out:
                error = inspection.describe_stall(workspace)
                return found + [NodeClass(run=left.run, error=error) for left in requests[len(found) :]]
            ended[requests[len(found)].run] = inspection.describe_crash()
        return found

    def _finish(self, inspection: Inspection) -> None:
        """Wait for the end of an inspecting child: a silent one is aborted, then killed."""
        while True:
            if not self._readable(class_inspection.IMPORT_TIMEOUT_S):
                self.signal(inspection.pid, signal.SIGKILL if inspection.timed_out else signal.SIGABRT)
                self.signal(inspection.pid, signal.SIGCONT)
                inspection.timed_out = True
                continue
            for event in self.read_events():
                if isinstance(event, Started):
                    inspection.pid = event.pid
                elif isinstance(event, Inspected):
                    inspection.add(event)
                else:
                    inspection.status, inspection.output = event.status, event.output
                    return

    def _readable(self, timeout_s: float) -> bool:
        """Wait for events of children, or for the user; return whether there are events."""
        wanted = [self.descriptor, *([self._interrupt.descriptor] if self._interrupt is not None else [])]
        ready = select.select(wanted, (), (), timeout_s)[0]
        if self._interrupt is not None:
            self._interrupt.check()
        return self.descriptor in ready

    def wake(self) -> None:
        """Let it go on, should it have been stopped: the end needs it."""
        self._process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End every child and the server; returns when they are gone."""
        self._channel.close()
        try:
            self._process.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:  # stopped, perhaps; its death is that of its children
            self._process.kill()
            self._process.wait()


class _Server:
    def __init__(self, connection: socket.socket) -> None:
        self._channel = MessageChannel(connection, msgspec.msgpack.Decoder(Request))
        self._wake, self._wake_write = _quiet_pipe()
        self._inspections: dict[int, tuple[MessageChannel[HeavyImport | Inspected], int, ToRun]] = {}
        self._children: dict[int, str] = {}
        self._recorders: set[int] = set()
        self._prints: dict[int, int] = {}
        self._logs = LogWriter()
        self._pid = os.getpid()
        adopt_orphans()
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._wake_write, warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        self._poll = select.poll()
        for descriptor in (connection.fileno(), self._wake):
            self._poll.register(descriptor, select.POLLIN)

    def serve(self) -> None:
        channel = self._channel.socket.fileno()
        with contextlib.suppress(ChannelClosed):
            while True:
                ready = {descriptor for descriptor, _ in self._poll.poll()}
                for descriptor in ready - {channel, self._wake}:
                    inspecting = descriptor in self._inspections
                    if not (self._read_inspector if inspecting else self._logs.read)(descriptor):
                        self._poll.unregister(descriptor)  # closed by a node that lives on: nothing will come
                if self._wake in ready:
                    self._reap()
                if channel in ready:
                    self._channel.fill()
                    while self._channel.buffered():
                        self._execute(self._channel.receive())
        self._end_all()

    def _execute(self, request: Request) -> None:
        if isinstance(request, Signal):
            if request.pid in self._children:
                os.kill(request.pid, request.number)
            return
        try:
            self._start(request)
        except OSError as error:  # no room for one more process: those that there are go on
            name = request.place if isinstance(request, Spawn) else INSPECTING
            self._send_event(Started(name, NO_PROCESS))
            self._send_event(Exited(name, NO_PROCESS, NOT_STARTED + (error.errno or 0)))

    def _start(self, request: Spawn | InspectClasses) -> None:
        if isinstance(request, InspectClasses):
            return self._start_inspection(request)
        read_end, write_end = self._logs.open(request.spec.name, Path(request.log))
        try:
            pid = self._fork(request.place, write_end, lambda: _run(request))
            self._prints[pid] = read_end
            if request.spec.run == RECORDER:
                self._recorders.add(pid)
        except OSError:
            self._logs.close(read_end)
            raise
        finally:
            os.close(write_end)
        self._poll.register(read_end, select.POLLIN)

    def _start_inspection(self, request: InspectClasses) -> None:
        ours, theirs = socket.socketpair()
        printed = os.memfd_create("printed")
        output = os.dup(printed)
        try:
            with theirs:
                send = MessageChannel(theirs, msgspec.msgpack.Decoder(Request)).send
                self._prints[self._fork(INSPECTING, output, lambda: inspect_in_child(request, send))] = (
                    ours.fileno()
                )
        except OSError:
            ours.close()
            os.close(printed)
            raise
        finally:
            os.close(output)
        channel = MessageChannel(ours, msgspec.msgpack.Decoder(HeavyImport | Inspected))
        self._inspections[ours.fileno()] = channel, printed, request.to_run
        self._poll.register(ours, select.POLLIN)

    def _fork(self, name: str, output: int, work: Callable[[], int]) -> int:
        gc.freeze()  # a child's collector leaves what is shared alone: neither time nor copied pages
        pid = os.fork()
        if pid == 0:
            run_child(work, self._pid, output, self._release)
        self._children[pid] = name
        self._send_event(Started(name, pid))
        return pid

    def _release(self) -> None:
        """In a child: let go of what is the server's."""
        self._channel.close()
        for descriptor in (self._wake, self._wake_write):
            os.close(descriptor)
        for channel, printed, _ in self._inspections.values():
            channel.close()
            os.close(printed)
        self._logs.release()

    def _read_inspector(self, descriptor: int) -> bool:
        """Pass on what an inspecting child sends, import what its nodes need; return False at the end."""
        channel, _, to_run = self._inspections[descriptor]
        try:
            channel.fill(socket.MSG_DONTWAIT)
        except ChannelClosed:
            return False
        while channel.buffered():
            message = channel.receive()
            if isinstance(message, HeavyImport) and to_run == "forked":
                import_heavy(message.module)
                message = HeavyImport("")
            self._send_event(message)
        return True

    def _send_event(self, event: ChildEvent | HeavyImport) -> None:
        with contextlib.suppress(ChannelClosed):  # the launcher is gone: the loop sees the channel's end next
            self._channel.send(event)

    def _reap(self) -> None:
        """Account for who has ended; the rest of its process group ends with it, and its log is complete."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake, 4096)
        while (gone := _next_gone()) is not None:
            pid, status = gone
            output, read_end = "", self._prints.get(pid)
            if read_end in self._inspections:
                output = self._end_inspection(read_end)
            elif read_end is not None:
                self._logs.close(read_end)
            if read_end is not None:
                del self._prints[pid]
                with contextlib.suppress(KeyError):
                    self._poll.unregister(read_end)
            if pid in self._children:
                self._send_event(Exited(self._children.pop(pid), pid, status, output))

    def _end_inspection(self, descriptor: int) -> str:
        """Pass on the last answers of an inspecting child that has ended; return the end of its output."""
        while self._read_inspector(descriptor):
            pass
        channel, printed, _ = self._inspections.pop(descriptor)
        start = max(os.fstat(printed).st_size - OUTPUT_BYTES, 0)
        output = os.pread(printed, OUTPUT_BYTES, start).decode(errors="replace")
        os.close(printed)
        channel.close()
        return output

    def _end_all(self) -> None:
        """End the nodes, then the recorders, which take what these still publish and finish their bags."""
        self._end([pid for pid in self._children if pid not in self._recorders], GRACE_NS)
        self._end([pid for pid in self._children if pid in self._recorders], RECORDER_GRACE_NS)
        self._reap()
        self._end_adopted()

    def _end(self, pids: Sequence[int], grace_ns: int) -> None:
        deadline_ns = monotonic_ns() + grace_ns
        for pid in pids:
            for number in (signal.SIGTERM, signal.SIGCONT):  # a stopped one, too, gets to its safe state
                os.kill(pid, number)
        while self._children.keys() & pids and (left_ns := deadline_ns - monotonic_ns()) > 0:
            if select.select((self._wake,), (), (), left_ns / 1e9)[0]:
                self._reap()
        for pid in self._children.keys() & pids:
            os.kill(pid, signal.SIGKILL)
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)

    def _end_adopted(self) -> None:
        """End what children have started in process groups of their own and left to this process.

        A guard that brings a dead node's device to rest has the time for it.
        """
        deadline_ns = monotonic_ns() + GRACE_NS
        for pid in self._adopted():
            os.kill(pid, signal.SIGTERM)
        while self._adopted() and (left_ns := deadline_ns - monotonic_ns()) > 0:
            select.select((self._wake,), (), (), left_ns / 1e9)
            self._reap()
        while left := self._adopted():
            for pid in left:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)

    def _adopted(self) -> list[int]:
        children = Path(f"/proc/self/task/{self._pid}/children")
        return [int(pid) for pid in children.read_text(encoding="ascii").split()] if children.exists() else []


def _run(order: Spawn) -> int:
    spec = order.spec
    apply_scheduling(spec.name, spec.realtime_priority)
    from palp_core.graph.process.main import run_node

    return run_node(order)


def _quiet_pipe() -> tuple[int, int]:
    ends = os.pipe()
    for end in ends:
        os.set_blocking(end, False)
    return ends


def _next_gone() -> tuple[int, int] | None:
    """Reap a child that has ended; return its number and status, or None."""
    try:
        found = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return None
    if found is None:
        return None
    with contextlib.suppress(OSError):  # until it is reaped, no other process has its number
        os.killpg(found.si_pid, signal.SIGKILL)
    _, status = os.waitpid(found.si_pid, 0)
    return found.si_pid, os.waitstatus_to_exitcode(status)


def fork_server() -> ServerProcess:
    """Fork a server off this process, which has one thread and imported what a check needs, of no workspace.

    Its hash seed is not fixed: no node is to run in it.
    """
    ours, theirs = socket.socketpair()

    def serve() -> None:
        ours.close()
        if not sys.flags.safe_path:
            del sys.path[0]  # as start_fork_server has it: the folder of the command, or where the user is
        _Server(theirs).serve()

    with theirs:
        return ServerProcess(Fork(serve), ours)


def main(connection: socket.socket) -> None:
    open_many_files()
    gc.disable()  # nothing here makes cycles; collecting while importing costs a tenth of the time
    for name in LIGHT:
        importlib.import_module(name)
    _Server(connection).serve()


if __name__ == "__main__":
    main(socket.socket(fileno=int(sys.argv[1])))
    os._exit(0)  # nothing is left to tidy, and tearing numpy down takes longer than all of the end
