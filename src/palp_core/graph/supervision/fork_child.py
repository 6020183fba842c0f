"""What a child process does for itself: share its parent's death, release the fork server, take its place."""

import ctypes
import faulthandler
import gc
import io
import logging
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from typing import NoReturn

from palp_core.graph.log_format import begin_log

MOST_FILES = 1 << 16
_SET_DEATH_SIGNAL, _SET_CHILD_SUBREAPER = 1, 36
_LIBC = ctypes.CDLL(None, use_errno=True)  # loaded once: a freshly forked process only calls


def die_with_parent(parent: int = 0) -> None:
    """Let this process be killed when its parent dies; at once if it is no child of ``parent`` any more."""
    _LIBC.prctl(_SET_DEATH_SIGNAL, signal.SIGKILL)
    if parent and os.getppid() != parent:
        os._exit(1)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent dies."""
    _LIBC.prctl(_SET_CHILD_SUBREAPER, 1)


def open_many_files() -> None:
    """Let this process open as many files as the user may, three of each node of a graph among them."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < MOST_FILES:
        most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def run_child(work: Callable[[], int], server: int, output: int, release: Callable[[], None]) -> NoReturn:
    """Turn a freshly forked process into what ``work`` does, and end with the status it returns."""
    status = 1
    try:
        os.setsid()
        die_with_parent(server)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        _redirect(output)
        release()
        gc.enable()
        faulthandler.enable()  # a crash in C names its Python lines
        status = work()
    except BaseException:  # noqa: BLE001 - nothing may escape into the fork server's loop
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _redirect(output: int) -> None:
    """Send output on without buffering, so that the last words of a crash are there.

    It is UTF-8, whatever the encoding of the launcher's own output.
    """
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            io.FileIO(number, "w", closefd=False), "utf-8", "backslashreplace", write_through=True
        )
        for number in (1, 2)
    )


def apply_scheduling(name: str, realtime_priority: int) -> None:
    """Move the process to the scheduler that its launch entry asks for.

    Before the node begins, so that its threads inherit it. What the host refuses is logged, with the limit
    and how to raise it, and the node goes on without.
    """
    if not realtime_priority:
        return
    begin_log(name)
    highest = os.sched_get_priority_max(os.SCHED_FIFO)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(min(realtime_priority, highest)))
    except OSError as error:
        limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
        logging.getLogger(f"palp.{name}").warning(
            "real-time priority %d refused (%s; the limit RLIMIT_RTPRIO is %s): it runs with the ordinary "
            "scheduler. Raise the limit with a line '%s - rtprio %d' in /etc/security/limits.conf and a new "
            "login, or start palp under 'systemd-run --user --scope -p LimitRTPRIO=%d'",
            realtime_priority,
            error.strerror,
            "none" if limit == resource.RLIM_INFINITY else limit,
            os.environ.get("USER", "USER"),
            realtime_priority,
            realtime_priority,
        )
