"""What a node class declares, found out by a child that imports it: the launcher imports no workspace.

The child sends its answers, one by one, to the fork server, which passes them on to the launcher. Before it
imports what is heavy it announces that, and the same is imported meanwhile where its nodes are to run: by the
server that forks them, or by the launcher that composes them. One that has neither answered nor announced
anything for a while is aborted, which leaves a back-trace.
"""

import contextlib
import importlib
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspected
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.process.channel import ChannelMessage

HEAVY = frozenset(
    {
        "scipy.fft", "scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.ndimage",
        "scipy.optimize", "scipy.signal", "scipy.sparse", "scipy.spatial", "scipy.special", "scipy.stats",
        "scipy", "pywt", "yaml",
    }
)  # fmt: skip
"""With palp's own modules, of which the rig's nodes share three hundred."""
OF_SCIPY = tuple(f"scipy.{name}" for name in ("special", "optimize", "interpolate", "linalg", "signal"))
"""What ``import scipy`` alone leaves until a handler names it, and half a second is too late there."""
INSPECTING = ""
"""Name of an inspecting child."""
IMPORT_TIMEOUT_S = 60.0
"""How long the child may neither answer nor announce a heavy module (assumed: longer than any import)."""
OUTPUT_BYTES = 1 << 16
"""What is kept of the end of its output."""
NOT_STARTED = 256
"""Added to the error's number it is the status: no process ends with one as high."""
_TRACE = re.compile(r"Fatal Python error.*?most recent call first", re.DOTALL)
_FRAME = re.compile(r'File "([^"]+)", line (\d+)')

ToRun = Literal["forked", "composed", "nowhere"]
"""Where nodes of inspected classes are to run: forked by the server, within the launcher, or nowhere."""


class InspectClasses(ChannelMessage, frozen=True):
    """Fork a child that inspects node classes."""

    requests: list[NodeClassRequest]
    workspace: str
    to_run: ToRun = "forked"


class HeavyImport(ChannelMessage, frozen=True):
    """An inspecting child is about to import this; "" is a sign of life from a server that has done so."""

    module: str


class Inspected(ChannelMessage, frozen=True):
    """An encoded :class:`NodeClass`; ``pid`` is the child's."""

    answer: bytes
    pid: int


class Inspection:
    """What an inspecting child has sent."""

    def __init__(self) -> None:
        self.pid = 0  # before it has begun
        self.answers: list[NodeClass] = []
        self.status: int | None = None
        self.output = ""
        self.timed_out = False  # it was silent for too long

    def add(self, message: Inspected) -> None:
        if message.pid == self.pid:
            self.answers.append(decode_any(NodeClass, message.answer))

    def describe_crash(self) -> str:
        """Return how the child ended, with its place or its last lines."""
        frames = self._frames()
        lines = " | ".join(self.output.strip().splitlines()[-3:])
        last = f'in "{frames[0][0]}", line {frames[0][1]}' if frames else lines
        return f"the process that imported it {describe_exit(self.status or 0)}" + (
            f": {last}" if last else ""
        )

    def describe_stall(self, workspace: Path) -> str:
        """Return where the child was when its time was over."""
        frames = self._frames()
        own = [(Path(file), line) for file, line in frames if Path(file).is_relative_to(workspace)]
        place = f"{own[0][0].relative_to(workspace)}:{own[0][1]}: " if own else ""
        return (
            f"{place}importing this does not come to an end (nothing happened for {IMPORT_TIMEOUT_S:g} s); "
            "what works or waits belongs in a handler. Nodes that come after it were not looked at"
        )

    def _frames(self) -> list[tuple[str, str]]:
        """Return file and line of each call, if it crashed or was aborted."""
        crash = _TRACE.search(self.output)
        return _FRAME.findall(self.output, crash.end()) if crash else []


def describe_exit(status: int) -> str:
    """Return how a process ended.

    >>> describe_exit(NOT_STARTED + 11), describe_exit(1)
    ('could not be started: Resource temporarily unavailable', 'ended with status 1')
    """
    if status >= NOT_STARTED:
        return f"could not be started: {os.strerror(status - NOT_STARTED)}"
    if status < 0:
        named = -status in {int(number) for number in signal.Signals}
        return f"was killed by {signal.Signals(-status).name if named else f'signal {-status}'}"
    return f"ended with status {status}"


def inspect_in_child(request: InspectClasses, send: Callable[[ChannelMessage], None]) -> int:
    """Inspect classes in a forked child, and send the answers."""
    if request.to_run != "nowhere":
        sys.meta_path.insert(0, _HeavyImports(send))
    for answer in inspected(request.requests, Path(request.workspace)):
        send(Inspected(encode_any(answer), os.getpid()))
    return 0


class _HeavyImports:
    """A finder that finds nothing: it announces heavy modules, and leaves the search to others."""

    def __init__(self, send: Callable[[ChannelMessage], None]) -> None:
        self._send = send

    def find_spec(self, name: str, _path: Sequence[str] | None = None, _target: object = None) -> None:
        for module in OF_SCIPY if name == "scipy" else (name,):
            if _is_heavy(module):
                with contextlib.suppress(OSError):
                    self._send(HeavyImport(module))


def _is_heavy(module: str) -> bool:
    return module in HEAVY or module.startswith("palp_core.")


def import_heavy(module: str) -> None:
    """Import what was announced, of what is heavy."""
    if _is_heavy(module):
        with contextlib.suppress(ImportError):  # the child has met it too, and says so
            importlib.import_module(module)
