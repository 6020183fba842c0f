"""One node as the supervisor sees it: its process, its log, how far it is."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import msgspec

from palp_core.runtime.spec import NodeSpec

__all__ = ["Member", "how_it_ended"]

LOG_LINES = 12
LOG_TAIL_BYTES = 1 << 16


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

    def plan_restart(self, now_ns: int, cause: str) -> bool:
        """Plan a new process after a back-off that doubles each time, and say so in the log.

        Returns:
            False if the node was never active or its rule does not allow another start.
        """
        spec = self.spec
        was_active = self.active or self.restart_count > 0
        if not was_active or spec.restart != "on_failure" or self.restart_count >= spec.max_restarts:
            return False
        self.restart_count += 1
        self.spec = msgspec.structs.replace(spec, epoch=spec.epoch + 1)
        backoff_s = spec.backoff_s * 2 ** (self.restart_count - 1)
        self.respawn_at_ns = now_ns + round(backoff_s * 1e9)
        with self.log.open("a") as log:
            log.write(
                f"[WARNING] [supervisor]: {spec.name} {cause}; restart {self.restart_count} of "
                f"{spec.max_restarts} in {backoff_s:g} s\n"
            )
        return True

    def last_words(self) -> str:
        """Return where the log is and its last lines."""
        try:
            with self.log.open("rb") as log:
                log.seek(max(log.seek(0, os.SEEK_END) - LOG_TAIL_BYTES, 0))
                lines = log.read().decode(errors="replace").strip().splitlines()[-LOG_LINES:]
        except OSError:
            lines = []
        return f" (log: {self.log})" + "".join(f"\n    {line}" for line in lines)


def how_it_ended(status: int) -> str:
    """Say in words how a process ended."""
    if status < 0:
        return f"was killed by {signal.Signals(-status).name}"
    return f"ended with status {status}"
