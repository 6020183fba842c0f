"""The parent of every node's process: warm, single-threaded, and the guarantee that no orphan remains.

It is started by the supervisor, imports the heavy libraries once (no zmq, nothing of the workspace), and
forks on request from its main thread only. When the supervisor's line closes, it brings all children down
(SIGTERM, then SIGKILL after a grace of 0.6 s) and exits. If it is killed itself, the kernel kills its
children. What a node has started goes with the node; what has left the node's process group, with the server.

Run as ``python -m palp_core.launch.fork_server <descriptor of the line>``.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import select
import signal
import socket
import sys
import traceback
from pathlib import Path
from typing import NoReturn

import msgspec

from palp_core.launch.describe import DescribeRequest, describe
from palp_core.runtime.birth import NodeProcess
from palp_core.runtime.clock import monotonic_ns
from palp_core.runtime.link import Line, Link, LinkClosed
from palp_core.runtime.message import encode_any

__all__ = ["Describe", "Exited", "Signal", "Spawn", "Started", "main", "preload"]

GRACE_NS = 600_000_000
PR_SET_PDEATHSIG = 1
PR_SET_CHILD_SUBREAPER = 36
HEAVY = ("numpy", "scipy.interpolate", "scipy.signal", "pywt", "msgspec", "msgpack", "yaml")


class Spawn(Line, frozen=True):
    """Fork a node; its output goes to ``log``."""

    birth: NodeProcess
    log: str


class Describe(Line, frozen=True):
    """Fork a child that describes node classes and writes the answer to a file."""

    requests: list[DescribeRequest]
    workspace: str
    answer: str


class Signal(Line, frozen=True):
    """Send a signal to a child."""

    pid: int
    number: int


class Started(Line, frozen=True):
    """A child lives; ``name`` is empty for a describing child."""

    name: str
    pid: int


class Exited(Line, frozen=True):
    """A child is gone and reaped; ``status`` is as :func:`os.waitstatus_to_exitcode` gives it."""

    name: str
    pid: int
    status: int


Request = Spawn | Describe | Signal
News = Started | Exited


def preload() -> None:
    """Import what every node needs, once, before the first fork."""
    for name in HEAVY:
        importlib.import_module(name)


def main(connection: socket.socket) -> None:
    """Serve until the supervisor's line closes, then end every child."""
    wake_read, wake_write = os.pipe()
    os.set_blocking(wake_write, False)
    os.set_blocking(wake_read, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake_write, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    server = os.getpid()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1)
    line = Link(connection, msgspec.msgpack.Decoder(Request))
    children: dict[int, str] = {}
    preload()
    while True:
        ready, _, _ = select.select([connection.fileno(), wake_read], [], [])
        if wake_read in ready:
            os.read(wake_read, 4096)
            for pid, status in _reap():
                if pid in children:
                    _tell(line, Exited(children.pop(pid), pid, status))
        if connection.fileno() not in ready:
            continue
        try:
            line.fill()
        except LinkClosed:
            break
        while line.buffered():
            request = line.receive()
            if isinstance(request, Signal):
                if request.pid in children:
                    os.kill(request.pid, request.number)
                continue
            pid = os.fork()
            if pid == 0:
                _become(request, libc, server, line, (wake_read, wake_write))
            name = request.birth.spec.name if isinstance(request, Spawn) else ""
            children[pid] = name
            _tell(line, Started(name, pid))
    _end_all(set(children), wake_read)
    _end_adopted(server)


def _tell(line: Link[Request], news: News) -> None:
    with contextlib.suppress(LinkClosed):  # the supervisor is gone: the loop sees the end of the line next
        line.send(news)


def _reap() -> list[tuple[int, int]]:
    """Return who has ended, and how; the rest of its process group ends with it."""
    gone: list[tuple[int, int]] = []
    while True:
        try:
            found = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        except ChildProcessError:
            return gone
        if found is None:
            return gone
        with contextlib.suppress(OSError):  # while it is not yet reaped, its number is nobody else's
            os.killpg(found.si_pid, signal.SIGKILL)
        _, status = os.waitpid(found.si_pid, 0)
        gone.append((found.si_pid, os.waitstatus_to_exitcode(status)))


def _end_adopted(server: int) -> None:
    """Kill what children have started in process groups of their own and left to this process."""
    adopted = Path(f"/proc/self/task/{server}/children")
    while left := adopted.read_text(encoding="ascii").split() if adopted.exists() else []:
        for pid in map(int, left):
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)


def _end_all(children: set[int], wake_read: int) -> None:
    deadline_ns = monotonic_ns() + GRACE_NS
    for pid in children:
        os.kill(pid, signal.SIGTERM)
    while children:
        children -= {pid for pid, _ in _reap()}
        left_s = (deadline_ns - monotonic_ns()) / 1e9
        if not children:
            return
        if left_s <= 0.0:
            break
        if select.select((wake_read,), (), (), left_s)[0]:
            os.read(wake_read, 4096)
    for pid in children:
        os.kill(pid, signal.SIGKILL)
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    _reap()


def _become(
    request: Spawn | Describe, libc: ctypes.CDLL, server: int, line: Link[Request], wake: tuple[int, int]
) -> NoReturn:
    """Turn a freshly forked process into a node or a describing child; never returns."""
    status = 1
    try:
        os.setsid()
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != server:
            os._exit(1)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        line.close()
        for descriptor in wake:
            os.close(descriptor)
        if isinstance(request, Spawn):
            _redirect(request.log)
            from palp_core.runtime.node_main import run_node

            status = run_node(request.birth)
        else:
            _redirect(request.answer + ".log")
            answer = describe(request.requests, Path(request.workspace))
            temporary = Path(request.answer + ".part")
            temporary.write_bytes(encode_any(answer))
            temporary.rename(request.answer)
            status = 0
    except BaseException:  # noqa: BLE001 - nothing may escape into the fork server's loop
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _redirect(log: str) -> None:
    """Send output to a file, line by line, so that the last words of a crash are there."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.close(descriptor)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]


if __name__ == "__main__":
    main(socket.socket(fileno=int(sys.argv[1])))
