"""Composed nodes run in a child of the process that was started: a node could end its own with any status."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable
from functools import partial

from palp_core.cli.output import note

WATCHED = "PALP_WATCHED"
"""In the environment up to the exec: the descriptor by which an end is announced, and the parent."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def go_on_watched() -> Callable[[], None]:
    """Return in a child, with what announces its end; the parent waits for that, and exits as the child does.

    The child has a fixed hash seed: sets have the order that they have in processes of nodes.
    """
    from palp_core.graph.supervision.fork_child import die_with_parent

    if WATCHED in os.environ:
        descriptor, parent = map(int, os.environ.pop(WATCHED).split())
    else:
        read_end, descriptor = os.pipe()
        parent = os.getpid()
        if child := os.fork():
            os.close(descriptor)
            sys.exit(_wait(child, read_end))
        os.close(read_end)
        if os.environ.get("PYTHONHASHSEED") != "0":
            os.set_inheritable(descriptor, True)
            os.environ |= {"PYTHONHASHSEED": "0", WATCHED: f"{descriptor} {parent}"}
            os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    os.set_inheritable(descriptor, False)
    die_with_parent(parent)
    return lambda: os.close(descriptor) if os.write(descriptor, b".") else None


def _wait(child: int, read_end: int) -> int:
    """Wait for the child, which gets the signals of this process; return the exit status."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, partial(_forward, child))
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    announced = False
    os.set_blocking(read_end, False)  # what a node has started may hold the other end
    with contextlib.suppress(BlockingIOError):
        announced = os.read(read_end, 1) == b"."
    if code < 0:
        from palp_core.graph.supervision.class_inspection import describe_exit

        if -code not in SIGNALS:
            note(f"the process of all nodes {describe_exit(code)}")
        return 128 - code
    if code == 0 and not announced:
        note("a node ended the process of all nodes with status 0")
        return 1
    return code


def _forward(child: int, number: int, _: object) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, number)
