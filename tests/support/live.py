"""A recorder of a running graph, started and ended as a user does."""

from __future__ import annotations

import signal
import subprocess

from tests.support.palp import PATIENCE_S, Palp


def recording(palp: Palp, *arguments: object) -> subprocess.Popen[str]:
    """Start a recorder; return when it says that it records."""
    process = palp.start("bag", "record", *arguments)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("recording "):
            return process
    raise AssertionError("the recorder ended before it recorded")


def ended(process: subprocess.Popen[str], number: signal.Signals | None = signal.SIGINT) -> str:
    """End a recorder; return what it printed last."""
    if number is not None:
        process.send_signal(number)
    out, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, out + errors
    return out
