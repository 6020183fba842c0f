"""One node as the supervisor sees it: its process, its log, how far it is."""

from __future__ import annotations

import signal
from pathlib import Path

from palp_core.runtime.spec import NodeSpec

__all__ = ["Member", "how_it_ended"]

LOG_LINES = 12


class Member:
    """One node as the supervisor sees it."""

    def __init__(self, spec: NodeSpec, log: Path) -> None:
        self.spec = spec
        self.log = log
        self.restart_count = 0
        self.begin()

    def begin(self) -> None:
        """Forget the process, before a start or a restart."""
        self.pid = 0
        self.configured = self.matched = self.active = self.ended = False
        self.respawn_at_ns: int | None = None

    def last_words(self) -> str:
        """Return where the log is and its last lines."""
        try:
            lines = self.log.read_text(errors="replace").strip().splitlines()[-LOG_LINES:]
        except OSError:
            lines = []
        return f" (log: {self.log})" + "".join(f"\n    {line}" for line in lines)


def how_it_ended(status: int) -> str:
    """Say in words how a process ended."""
    if status < 0:
        return f"was killed by {signal.Signals(-status).name}"
    return f"ended with status {status}"
