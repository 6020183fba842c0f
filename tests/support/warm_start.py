"""Start ``palp`` and its fork servers as forks of a process that has imported them already.

To start Python with numpy and palp takes half a second of CPU time, twice for each graph, and the tests do it
some thousand times. What is forked is a process like any other: a child of the test's own, with command line,
environment and descriptors, and a signal ends it. ``Palp.command`` starts as a user does.
"""

from __future__ import annotations

import ast
import contextlib
import ctypes
import fcntl
import gc
import importlib
import inspect
import io
import os
import signal
import socket
import subprocess
import sys
import threading
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import msgspec

ROOT = Path(__file__).parents[2]
SCRIPT = str(Path(sys.executable).with_name("palp"))
"""As a user does: ``python -m`` ends by SIGINT, not with 130, where Ctrl-C comes within an ``exec``."""
MARK = "PALP_TEST_MARK"
MARK_LENGTH = 32
COMMAND_LENGTH = 8000
LARGEST_REQUEST = 1 << 17
LARGEST_ANSWER = 100
HIGH = 300
"""Descriptors wait from here on until those below are free."""

PR_SET_CHILD_SUBREAPER = 36
FORK_SERVER = "palp_core.graph.supervision.fork_server"
COMMANDS = (
    *("palp_core.cli.main", "palp_core.cli.launch.launch", "palp_core.cli.launch.view"),
    *("palp_core.cli.launch.stop_key", "palp_core.graph.launch.graph", FORK_SERVER),
)
OWN = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "PYTHONHASHSEED": "0",
    "PYTHONUNBUFFERED": "1",
    "PYTHONPATH": str(ROOT / "src"),
}
"""How fork servers are started, and nearly how ``palp`` is."""

READ_AT_START = ("PYTHON", "LC_", "LANG", "COVERAGE", "TZ", "LD_", "OPENBLAS", "OMP", "MKL")
"""What variables begin with that are read once, while a process starts."""


class _Request(msgspec.Struct):
    command: list[str]
    environment: dict[str, str]
    folder: str
    own_session: bool
    passed: list[int]


class ForkedPopen(subprocess.Popen[Any]):
    """A ``Popen`` of ``palp`` or of its fork server, forked where its environment allows it."""

    fork: ClassVar[Callable[[_Request, Sequence[int]], int]]
    """Forks a process with these descriptors as 0, 1, 2 and those that are passed; returns its id."""

    def _execute_child(self, *given: Any) -> None:
        execute = subprocess.Popen._execute_child  # type: ignore[attr-defined]
        wanted = inspect.signature(execute).bind(self, *given).arguments
        command = [os.fspath(word) for word in wanted["args"]]
        environment = os.environ if wanted["env"] is None else wanted["env"]
        known = command[:2] == [sys.executable, SCRIPT] or command[1:4] == ["-P", "-m", FORK_SERVER]
        if not known or _at_start(OWN | dict(environment)) != _at_start(OWN | dict(os.environ)):
            execute(self, *given)
            return
        ends = [wanted[name] for name in ("p2cread", "c2pwrite", "errwrite")]
        request = _Request(
            command=command,
            environment={**environment, "PYTHONHASHSEED": "0"},
            folder=os.fspath(wanted["cwd"] or Path.cwd()),
            own_session=wanted["start_new_session"],
            passed=sorted(wanted["pass_fds"]),
        )
        standard = [number if end == -1 else end for number, end in enumerate(ends)]
        try:
            self.pid = type(self).fork(request, [*standard, *request.passed])
            self._child_created = True
        finally:
            names = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
            self._close_pipe_fds(*(wanted[name] for name in names))  # type: ignore[attr-defined]


def fork_servers_too() -> None:
    """Let :func:`palp_core.graph.supervision.fork_start.start_fork_server` fork, in this process."""
    from palp_core.graph.supervision import fork_start

    forking = types.SimpleNamespace(**{**vars(subprocess), "Popen": ForkedPopen})
    vars(fork_start)["subprocess"] = forking


def _at_start(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(READ_AT_START)}


class _WarmProcess:
    """The process that a test worker lets fork; it ends with the worker."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._channel: socket.socket | None = None

    def fork(self, request: _Request, descriptors: Sequence[int]) -> int:
        with self._lock:
            self._channel = self._channel or self._start()
            socket.send_fds(self._channel, [msgspec.msgpack.encode(request)], descriptors)
            answer = self._channel.recv(LARGEST_ANSWER)
        if not answer:
            raise RuntimeError("the process that tests fork has ended")
        return int(answer)

    def _start(self) -> socket.socket:
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)  # what it forks twice is a child of this process
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno()), " " * COMMAND_LENGTH],
                pass_fds=[theirs.fileno()],
                env={**os.environ, **OWN, MARK: "0" * MARK_LENGTH},
                stdin=subprocess.DEVNULL,
            )
        return ours


ForkedPopen.fork = _WarmProcess().fork


def _import_what_they_need() -> None:
    """Import what the command line and every node of this repository import, but nothing of a workspace."""
    from palp_core.graph.supervision.class_inspection import OF_SCIPY

    for name in COMMANDS:
        importlib.import_module(name)
    for file in (ROOT / "nodes").glob("*.py"):
        for statement in ast.parse(file.read_bytes()).body:
            if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith("palp_core."):
                importlib.import_module(str(statement.module))
    for name in OF_SCIPY:
        importlib.import_module(name)


def _serve(channel: socket.socket) -> _Request:
    """Fork at each request; return in what was forked, with the request that it is for."""
    while True:
        data, descriptors, _, _ = socket.recv_fds(channel, LARGEST_REQUEST, 10)
        if not data:
            sys.exit()
        request = msgspec.msgpack.decode(data, type=_Request)
        here, there = socket.socketpair()
        middle = os.fork()
        if not middle:
            _look_like(request)
            if pid := os.fork():
                there.send(str(pid).encode())
                os._exit(0)
            here.close()
            channel.detach()
            there.recv(1)  # until its parent is gone
            _begin(request, descriptors)
            return request
        there.close()
        os.waitpid(middle, 0)
        channel.send(here.recv(LARGEST_ANSWER))
        for descriptor in (here.detach(), *descriptors):
            os.close(descriptor)


def _fork_here(request: _Request, descriptors: Sequence[int]) -> int:
    """Fork this process, which has one thread, to be a fork server."""
    pid = os.fork()
    if not pid:
        with contextlib.suppress(BaseException):
            _look_like(request)
            _begin(request, descriptors)
            _run(request)
        os._exit(1)
    return pid


def _look_like(request: _Request) -> None:
    """Put the command line and the mark of a test where others read those of a process."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    begin, end, environment, environment_end = map(int, fields[45:49])
    command = b"".join(word.encode() + b"\0" for word in request.command)
    ctypes.memmove(begin, command.ljust(end - begin, b"\0"), end - begin)
    mark = f"{MARK}=".encode()
    at = ctypes.string_at(environment, environment_end - environment).index(mark) + len(mark)
    ctypes.memmove(environment + at, request.environment.get(MARK, "").encode(), MARK_LENGTH)


def _begin(request: _Request, descriptors: Sequence[int]) -> None:
    """Take descriptors, environment, folder, session and standard streams as they come from ``exec``."""
    kept = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, HIGH) for descriptor in descriptors]
    os.closerange(3, HIGH)
    for wanted, descriptor in zip([0, 1, 2, *request.passed], kept, strict=True):
        os.dup2(descriptor, wanted)
        os.close(descriptor)
    os.environ.clear()
    os.environ.update(request.environment)
    encoding, _, errors = os.environ.get("PYTHONIOENCODING", "utf-8").partition(":")
    unbuffered = bool(os.environ.get("PYTHONUNBUFFERED"))
    sys.stdin = open(0, encoding=encoding, errors=errors or None, closefd=False)  # noqa: SIM115
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            open(number, "wb", 0 if unbuffered else -1, closefd=False),  # noqa: SIM115
            encoding,
            "backslashreplace" if number == 2 else errors or None,
            line_buffering=number == 2,
            write_through=unbuffered,
        )
        for number in (1, 2)
    )
    os.chdir(request.folder)
    if request.own_session:
        os.setsid()


def _run(request: _Request) -> None:
    words = request.command[1:]
    if FORK_SERVER in words:
        from palp_core.graph.supervision import fork_server

        fork_server.main(socket.socket(fileno=int(words[-1])))
        os._exit(0)
    from palp_core.__main__ import main

    sys.argv = words
    ForkedPopen.fork = _fork_here
    fork_servers_too()
    main()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the tests
    sys.path[:] = [folder for folder in sys.path if folder != str(Path(__file__).parent)]
    _import_what_they_need()
    gc.freeze()  # no fork looks through all that for garbage
    asked = _serve(socket.socket(fileno=int(sys.argv[1])))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _run(asked)
