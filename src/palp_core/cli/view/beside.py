"""A viewer beside a launcher: a process of its own, which the graph neither waits for nor dies of."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial

from palp_core.graph.supervision.fork_child import die_with_parent
from palp_core.view.server.serve import check_installed

END_S = 5.0


def check_can_show() -> None:
    """Check, before anything starts, that there is something to show it with.

    Raises:
        PalpError: The extra is not installed; what to type is in the message.
    """
    check_installed()


@contextlib.contextmanager
def shown_beside(run: str, *, operate: bool) -> Iterator[None]:
    """Show a running graph in the browser; the viewer ends with it.

    Args:
        run: Its id.
        operate: As of ``palp view``.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "palp_core", "view", "--graph", run, *(["--operate"] if operate else [])],
        stdin=subprocess.DEVNULL,
        env={**os.environ, "PYTHONHASHSEED": "random"},
        start_new_session=True,  # Ctrl-C is the launcher's
        preexec_fn=partial(die_with_parent, os.getpid()),  # and if that is killed, it goes, too
    )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
