"""One node as the supervisor sees it: its process, its log, how far it is."""

from __future__ import annotations

import signal
from pathlib import Path

import msgspec

from palp_core.graph.node.spec import LONGEST_BACKOFF_S, NodeSpec
from palp_core.graph.process.control_messages import FromNode, Spawn
from palp_core.graph.supervision.fork_server import ForkServer
from palp_core.graph.supervision.logs import LogLevels, note, tail

LOG_LINES = 20
STABLE_NS = 30_000_000_000
"""Work without failure after which earlier restarts count no more (assumed: no crash loop takes so long)."""


class ManagedProcess:
    """One node as the supervisor sees it."""

    def __init__(self, spec: NodeSpec, log: Path, place: str = "") -> None:
        self.spec = spec
        self.place = place or spec.name  # the name by which its process reports and has its endpoints
        self.log = log
        self.restart_count = 0
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        self.pid = 0
        self.configured = self.matched = self.active = self.done = self.ended = False
        self.is_silent = self.given_up = False
        self.handed_over = False  # everything, to a successor that can go on without it
        self.missing: list[str] = []  # readers of its last process that do not listen to this one
        self.replies: list[FromNode] = []  # what it has sent in a swap and nothing has taken yet
        self.begun_ns = self.active_ns = now_ns
        self.respawn_at_ns: int | None = None

    def activate(self, now_ns: int) -> None:
        self.active, self.active_ns = True, now_ns

    def absence(self) -> str:
        """Return why it does not work just now, as a text that follows its name; "" if it does."""
        if self.respawn_at_ns is not None or self.ended or not self.matched:
            return "is being restarted; ask again when it is active"
        if _state(self.pid) in ("T", "t"):
            return f"is stopped; continue it with: kill -CONT {self.pid}"
        if self.is_silent:
            return "has sent no heartbeat for seconds: a handler does not return; ask again when it has"
        return ""

    def has_died(self) -> bool:
        """Return whether its process is dead; :attr:`ended` is set when the fork server has reported it."""
        return self.ended or _state(self.pid) in ("Z", "X")

    def may_restart(self) -> bool:
        """Return whether its rule allows another start; it must have been active once."""
        was_active = self.active or self.spec.epoch > 0
        return (
            was_active and self.spec.restart == "on_failure" and self.restart_count < self.spec.max_restarts
        )

    def plan_restart(self, now_ns: int, cause: str) -> str:
        """Plan a new process after a back-off that doubles each time; return the plan, "" if none."""
        if self.active and now_ns - self.active_ns >= STABLE_NS:
            self.restart_count = 0
        if not self.may_restart():
            return ""
        spec = self.spec
        self.restart_count += 1
        self.spec = msgspec.structs.replace(spec, epoch=spec.epoch + 1)
        doubled = 2.0 ** min(self.restart_count - 1, 64)
        backoff_s = min(spec.backoff_s * doubled, LONGEST_BACKOFF_S)
        self.respawn_at_ns = now_ns + round(backoff_s * 1e9)
        text = f"{cause}; restart {self.restart_count} of {spec.max_restarts} in {backoff_s:g} s"
        note(self.log, "WARNING", f"{spec.name} {text}")
        return text

    def successor_spec(self, spec: NodeSpec) -> NodeSpec:
        """Return what a successor runs: with this one's epoch, as to a reader nothing is restarted."""
        return msgspec.structs.replace(spec, epoch=self.spec.epoch)

    def log_tail(self) -> str:
        """Return where the log is and its last lines."""
        return f" (log: {self.log})" + "".join(f"\n    {line}" for line in tail(self.log, LOG_LINES))


def _state(pid: int) -> str:
    """Return a process's state in the letters of proc(5); X: there is none; "": there is no /proc."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return "X" if Path("/proc/self").exists() else ""


class ProcessLauncher:
    def __init__(
        self, server: ForkServer, clock: str, folder: Path, workspace: str, levels: LogLevels
    ) -> None:
        self._server = server
        self._run = {
            "clock": clock, "run_dir": str(folder), "workspace": workspace
        }  # fmt: skip
        self._levels = levels

    def spawn(self, process: ManagedProcess, *, successor: bool = False, fresh: bool = False) -> None:
        order = Spawn(
            spec=process.spec, log=str(process.log), place=process.place, successor=successor, fresh=fresh,
            log_level=self._levels.logged(process.spec.name), **self._run,
        )  # fmt: skip
        self._server.send(order)

    def signal(self, process: ManagedProcess, *numbers: signal.Signals) -> None:
        for number in numbers:
            self._server.signal(process.pid, number)
