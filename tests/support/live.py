"""A recorder of a running graph, started and ended as a user does."""

from __future__ import annotations

import signal
import subprocess

from tests.support.palp import PATIENCE_S, Palp, wait_for_error


def recording(palp: Palp, *arguments: object) -> subprocess.Popen[str]:
    """Start a recorder; return when it says that it records."""
    process = palp.start("bag", "record", *arguments)
    wait_for_error(process, "recording ")
    return process


def ended(process: subprocess.Popen[str], number: signal.Signals | None = signal.SIGINT) -> str:
    """End a recorder; return what it printed last."""
    if number is not None:
        process.send_signal(number)
    out, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, out + errors
    return out
