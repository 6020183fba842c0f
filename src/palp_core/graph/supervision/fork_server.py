"""The parent of every node's process: warm, single-threaded, and the guarantee that no orphan remains.

Both ends of its channel are here: :class:`ForkServer` is the launcher's. It is started by the launcher,
imports what nodes share (see :mod:`.preload`), and forks on request from its main thread only. It writes down
what its children print. When the launcher's end closes, it brings all children down (SIGTERM, then SIGKILL
after a grace of 0.6 s) and exits. If it is killed itself, the kernel kills its children. What a node has
started goes with the node; what has left the node's process group, with the server, after the same grace.

Run as ``python -m palp_core.graph.supervision.fork_server <descriptor of the channel>``.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspected
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.process.control_messages import Spawn
from palp_core.graph.process.parent_death import adopt_orphans
from palp_core.graph.supervision.fork_child import apply_scheduling, run_child
from palp_core.graph.supervision.fork_start import ServerProcess, start_fork_server
from palp_core.graph.supervision.interrupt import Interrupt
from palp_core.graph.supervision.logs import LogWriter
from palp_core.graph.supervision.preload import ImportAnnouncer, import_heavy, preload, read_announced
from palp_core.user_folders import room_mistake
from palp_core.whole_file import PRIVATE, open_private

GRACE_NS = 600_000_000
CLOSE_TIMEOUT_S = 5.0
STILL_S = 10.0
"""How long an inspecting child may do nothing that can be seen: import no further module, give no answer."""

_TURN_S = 0.25
_LAST_WORDS_S = 2.0
_LENGTH_BYTES = 4
_CRASH = re.compile(r"Fatal Python error.*?most recent call first", re.DOTALL)
_FRAME = re.compile(r'File "([^"]+)", line (\d+)')
INSPECTING = ""
"""Name of an inspecting child."""
NO_PROCESS = 2**31 - 1
"""In place of the id of a process that could not be started: no process has one as high."""
NOT_STARTED = 256
"""Added to the error's number it is the status: no process ends with one as high."""


ToRun = Literal["forked", "composed", "nowhere"]
"""Where nodes of inspected classes are to run: forked by the server, within the launcher, or nowhere."""


class InspectClasses(ChannelMessage, frozen=True):
    """Fork a child that inspects node classes and writes the answer to a file.

    What is heavy is imported beside it where the nodes are to run: by the server, or by the launcher.
    """

    requests: list[NodeClassRequest]
    workspace: str
    answer: str
    to_run: ToRun = "forked"


class Signal(ChannelMessage, frozen=True):
    """Send a signal to a child."""

    pid: int
    number: int


class Started(ChannelMessage, frozen=True):
    """A child lives; ``name`` is empty for an inspecting child."""

    name: str
    pid: int


class Exited(ChannelMessage, frozen=True):
    """A child is gone and reaped, or could not be started.

    ``status`` is as :func:`os.waitstatus_to_exitcode` gives it, or :data:`NOT_STARTED` and more.
    """

    name: str
    pid: int
    status: int


class HeavyImports(ChannelMessage, frozen=True):
    """An inspecting child imports what is heavy, and the launcher is to run its nodes."""

    modules: list[str]


Request = Spawn | InspectClasses | Signal
ChildEvent = Started | Exited


class ForkServer:
    """A running fork server; closing it ends every process it has started.

    Args:
        interrupt: Raises when the user wants the end while node classes are looked at.
        started: Its process, if it was started before.
    """

    def __init__(self, interrupt: Interrupt | None = None, started: ServerProcess | None = None) -> None:
        self._interrupt = interrupt
        self._process, connection = started or start_fork_server()
        self._channel = MessageChannel(connection, msgspec.msgpack.Decoder(ChildEvent | HeavyImports))

    @property
    def descriptor(self) -> int:
        """Becomes readable when a child has started or ended."""
        return self._channel.socket.fileno()

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
            self._channel.send(request)
        except ChannelClosed as error:
            raise GraphError(f"the fork server (process {self.pid}) is gone: {error}") from error

    def signal(self, pid: int, number: signal.Signals) -> None:
        """Send a signal to a child."""
        self.send(Signal(pid, int(number)))

    def read_events(self) -> list[ChildEvent]:
        """Wait for events of children and return what there is; import what is announced.

        Raises:
            GraphError: The fork server is gone.
        """
        try:
            self._channel.fill()
        except ChannelClosed as error:
            raise GraphError(
                f"the fork server (process {self.pid}) has ended; its nodes ended with it"
            ) from error
        found = []
        while self._channel.buffered():
            item = self._channel.receive()
            if isinstance(item, HeavyImports):
                import_heavy(item.modules)
            else:
                found.append(item)
        return found

    def inspect_classes(
        self, requests: Sequence[NodeClassRequest], workspace: Path, folder: Path, *, to_run: ToRun = "forked"
    ) -> list[NodeClass]:
        """Let a forked child import node classes and say what they are.

        If one ends the child, that is what is said of it, and another child goes on with the next. If one
        does not come to an end, that is said of all that are left: they may well wait for the same module.

        Args:
            requests: What to look at.
            workspace: First on the module path.
            folder: Where the answer is written.
            to_run: Where nodes of these classes are to run, which then find loaded there what is heavy.

        Raises:
            GraphError: The fork server is gone.
            Interrupted: The user asked for the end.
        """
        answer = folder / "descriptions"
        found: list[NodeClass] = []
        ended: dict[str, str] = {}  # what ended a child once is not imported again
        while len(found) < len(requests):
            request = requests[len(found)]
            if request.run in ended:
                found.append(NodeClass(run=request.run, error=ended[request.run]))
                continue
            self.send(InspectClasses(list(requests[len(found) :]), str(workspace), str(answer), to_run))
            status = self._wait_for_inspector(answer)
            found += answers_in(answer)
            if len(found) == len(requests):
                break
            if status is None:
                words = stillness_in_words(answer, workspace)
                return found + [NodeClass(run=left.run, error=words) for left in requests[len(found) :]]
            ended[requests[len(found)].run] = death_in_words(status, answer)
        return found

    def _wait_for_inspector(self, answer: Path) -> int | None:
        """Return the exit status of the inspecting child, once it has ended; None if it had to be killed."""
        pid, seen, still_s = 0, (0, 0), 0.0
        while True:
            if self._readable(_TURN_S):
                for item in self.read_events():
                    if isinstance(item, Exited):
                        return item.status
                    pid = item.pid
            elif pid:  # turns are counted, not seconds: time in which this process was stopped is no sign
                before, seen = seen, _signs_of_life(answer)
                still_s = still_s + _TURN_S if seen == before else 0.0
                if still_s >= STILL_S:
                    self._kill_inspector(pid)
                    return None

    def _kill_inspector(self, pid: int) -> None:
        """End a child that does not end by itself; on the first signal it writes down where it is."""
        for number, patience_s in ((signal.SIGABRT, _LAST_WORDS_S), (signal.SIGKILL, None)):
            self.signal(pid, number)
            self.signal(pid, signal.SIGCONT)
            while self._readable(patience_s):
                if any(isinstance(item, Exited) for item in self.read_events()):
                    return

    def _readable(self, timeout_s: float | None) -> bool:
        """Wait for events of children, or for the user; tell whether there are events."""
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


def answers_in(file: Path) -> list[NodeClass]:
    """Take what an inspecting child has written, each answer behind its length; fewer if it died."""
    data = file.read_bytes() if file.exists() else b""
    file.unlink(missing_ok=True)
    answers, start = [], 0
    while start < len(data):
        end = start + _LENGTH_BYTES + int.from_bytes(data[start : start + _LENGTH_BYTES])
        if end > len(data):
            break
        answers.append(decode_any(NodeClass, data[start + _LENGTH_BYTES : end]))
        start = end
    return answers


def _signs_of_life(answer: Path) -> tuple[int, int]:
    """Return what changes when the inspecting child gives an answer or begins to import a module."""
    with contextlib.suppress(FileNotFoundError):
        found = answer.stat()
        return found.st_size, found.st_mtime_ns
    return 0, 0


def death_in_words(status: int, answer: Path) -> str:
    """Say how the inspecting child ended that was to write ``answer``, with its last words.

    On a full disk it ends so, too, and cannot say why.
    """
    said, frames = _last_words(answer)
    if (mistake := room_mistake(answer.parent)) is not None:
        return mistake
    words = f'in "{frames[0][0]}", line {frames[0][1]}' if frames else " | ".join(said.splitlines()[-3:])
    return f"the process that imported it {exit_in_words(status)}" + (f": {words}" if words else "")


def stillness_in_words(answer: Path, workspace: Path) -> str:
    """Say what the inspecting child was at that was to write ``answer`` and did not end by itself."""
    _, frames = _last_words(answer)
    own = [(Path(file), line) for file, line in frames if Path(file).is_relative_to(workspace)]
    place = f"{own[0][0].relative_to(workspace)}:{own[0][1]}: " if own else ""
    return (
        f"{place}importing this does not come to an end (nothing happened for {STILL_S:g} s); what works or "
        "waits belongs in a handler of the node. Nodes that come after it were not looked at"
    )


def _last_words(answer: Path) -> tuple[str, list[tuple[str, str]]]:
    """Take what an inspecting child has printed; if it crashed, also file and line of each call."""
    log = Path(f"{answer}.log")
    said = log.read_text(errors="replace").strip() if log.exists() else ""
    log.unlink(missing_ok=True)
    crash = _CRASH.search(said)
    return said, _FRAME.findall(said, crash.end()) if crash else []


def exit_in_words(status: int) -> str:
    """Say in words how a process ended.

    >>> exit_in_words(NOT_STARTED + 11), exit_in_words(1)
    ('could not be started: Resource temporarily unavailable', 'ended with status 1')
    """
    if status >= NOT_STARTED:
        return f"could not be started: {os.strerror(status - NOT_STARTED)}"
    if status < 0:
        named = -status in {int(number) for number in signal.Signals}
        return f"was killed by {signal.Signals(-status).name if named else f'signal {-status}'}"
    return f"ended with status {status}"


class _Server:
    """Children, what they print, and the launcher's end."""

    def __init__(self, connection: socket.socket) -> None:
        self._channel = MessageChannel(connection, msgspec.msgpack.Decoder(Request))
        self._wake, self._wake_write = _quiet_pipe()
        self._announced, self._announce = _quiet_pipe()
        self._composed = False
        self._children: dict[int, str] = {}
        self._prints: dict[int, int] = {}
        self._logs = LogWriter()
        self._pid = os.getpid()
        adopt_orphans()
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._wake_write, warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        self._poll = select.poll()
        for descriptor in (connection.fileno(), self._wake, self._announced):
            self._poll.register(descriptor, select.POLLIN)

    def serve(self) -> None:
        """Serve until the launcher's end closes, then end every child."""
        channel = self._channel.socket.fileno()
        with contextlib.suppress(ChannelClosed):
            while True:
                ready = {descriptor for descriptor, _ in self._poll.poll()}
                for descriptor in ready - {channel, self._wake}:
                    if descriptor == self._announced:
                        self._load_announced()
                    elif not self._logs.read(descriptor):
                        self._poll.unregister(descriptor)  # closed by a node that lives on: nothing will come
                if self._wake in ready:
                    self._load_announced()  # before an inspecting child's end is told
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
            self._composed = request.to_run == "composed"
            said = os.open(f"{request.answer}.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND, PRIVATE)
            try:
                self._fork(INSPECTING, said, lambda: self._inspect(request))
            finally:
                os.close(said)
            return
        read_end, write_end = self._logs.open(request.spec.name, Path(request.log))
        try:
            self._prints[self._fork(request.place, write_end, lambda: _run(request))] = read_end
        except OSError:
            self._logs.close(read_end)
            raise
        finally:
            os.close(write_end)
        self._poll.register(read_end, select.POLLIN)

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
        for descriptor in (self._wake, self._wake_write, self._announced):
            os.close(descriptor)
        self._logs.release()

    def _load_announced(self) -> None:
        modules = read_announced(self._announced)
        if not self._composed:
            import_heavy(modules)
        elif modules:
            self._send_event(HeavyImports(modules))

    def _inspect(self, request: InspectClasses) -> int:
        with open(request.answer, "wb", buffering=0, opener=open_private) as file:
            loads = request.to_run != "nowhere"
            announce = self._announce if loads else os.open(os.devnull, os.O_WRONLY)
            ImportAnnouncer(announce, lambda: os.utime(request.answer)).install()
            for answer in inspected(request.requests, Path(request.workspace)):
                data = encode_any(answer)
                file.write(len(data).to_bytes(_LENGTH_BYTES) + data)
        return 0

    def _send_event(self, event: ChildEvent | HeavyImports) -> None:
        with contextlib.suppress(ChannelClosed):  # the launcher is gone: the loop sees the channel's end next
            self._channel.send(event)

    def _reap(self) -> None:
        """Account for who has ended; the rest of its process group ends with it, and its log is complete."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake, 4096)
        while (gone := _next_gone()) is not None:
            pid, status = gone
            read_end = self._prints.pop(pid, None)
            if read_end is not None:
                with contextlib.suppress(KeyError):
                    self._poll.unregister(read_end)
                self._logs.close(read_end)
            if pid in self._children:
                self._send_event(Exited(self._children.pop(pid), pid, status))

    def _end_all(self) -> None:
        deadline_ns = monotonic_ns() + GRACE_NS
        for pid in self._children:
            for number in (signal.SIGTERM, signal.SIGCONT):  # a stopped one, too, gets to its safe state
                os.kill(pid, number)
        while self._children and (left_ns := deadline_ns - monotonic_ns()) > 0:
            if select.select((self._wake,), (), (), left_ns / 1e9)[0]:
                self._reap()
        for pid in self._children:
            os.kill(pid, signal.SIGKILL)
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        self._reap()
        self._end_adopted()

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
    apply_scheduling(spec.name, spec.cpus, spec.realtime_priority)
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
    with contextlib.suppress(OSError):  # while it is not yet reaped, its number is nobody else's
        os.killpg(found.si_pid, signal.SIGKILL)
    _, status = os.waitpid(found.si_pid, 0)
    return found.si_pid, os.waitstatus_to_exitcode(status)


def main(connection: socket.socket) -> None:
    """Serve until the launcher's end closes, then end every child."""
    gc.disable()  # nothing here makes cycles; collecting while importing costs a tenth of the time
    preload()
    _Server(connection).serve()


if __name__ == "__main__":
    main(socket.socket(fileno=int(sys.argv[1])))
    os._exit(0)  # nothing is left to tidy, and tearing numpy down takes longer than all of the end
