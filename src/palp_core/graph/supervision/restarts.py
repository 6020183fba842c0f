"""Keep nodes active on the wall clock: activate, restart by rule, notice silence."""

import logging
import signal
from collections.abc import Callable, Sequence

from palp_core.errors import NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.node.spec import RECORDER
from palp_core.graph.supervision.interrupt import KILL_NS
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.liveness import GIVE_UP_NS, Liveness
from palp_core.graph.supervision.managed_process import ManagedProcess, ProcessLauncher
from palp_core.graph.transport.restart_files import WAIT_NS

READY_NS = 60_000_000_000
"""In which a process must have configured its node (assumed: no device takes longer to answer)."""

HEALTH_NS = 1_000_000_000
LOOK_NS = 250_000_000
"""How often all nodes are looked at when nothing has happened: the resolution of silences."""
LATE_NS = 10_000_000_000
_LOG = logging.getLogger("palp.supervisor")


class Restarts:
    def __init__(
        self,
        processes: Sequence[ManagedProcess],
        launcher: ProcessLauncher,
        activate: Callable[[int], None],
        launcher_node: LauncherNode,
        *,
        restarts: bool,
    ) -> None:
        self._processes = processes
        self._launcher, self._activate = launcher, activate
        self._launcher_node = launcher_node
        self._restarts = restarts
        self._liveness = Liveness[int]()
        self._health_ns = self._look_ns = 0
        self._warned_late: set[int] = set()

    def look_soon(self) -> None:
        """Look at everybody in the next turn: something has happened to one of them."""
        self._look_ns = 0

    def run_due(self, now_ns: int) -> None:
        """Do what is due; a turn in which nothing is costs the same however many nodes there are."""
        if now_ns < self._look_ns:
            return
        self._look_ns = now_ns + LOOK_NS
        for index, process in enumerate(self._processes):
            if process.respawn_at_ns is not None:
                if now_ns >= process.respawn_at_ns:
                    self._start_next(process, now_ns)
            elif not process.active:
                self._activate_when_ready(index, now_ns)
        for index, silent_ns in self._liveness.unresponsive(now_ns):
            self._on_silence(index, silent_ns, now_ns)
        if now_ns >= self._health_ns:
            self._health_ns = now_ns + HEALTH_NS
            self._launcher_node.publish_health(self._liveness.health)
        due_ns = [process.respawn_at_ns for process in self._processes if process.respawn_at_ns is not None]
        self._look_ns = min([self._look_ns, self._health_ns, *(due for due in due_ns if due > now_ns)])

    def idle_s(self, now_ns: int) -> float:
        """Return how long nothing will be due."""
        return max((self._look_ns - now_ns) / 1e9, 0.001)

    def _activate_when_ready(self, index: int, now_ns: int) -> None:
        """Activate a node that is ready; give up one that is not."""
        process = self._processes[index]
        if process.matched:
            self._activate(index)
            process.activate(now_ns)
            self.expect_health(index)
            self._warned_late.discard(index)
            if process.spec.epoch:
                self._restarted(process)
        elif not process.configured and now_ns - process.begun_ns > READY_NS:
            self.recover(index, f"was not configured within {READY_NS // 10**9} s", signal.SIGKILL)
        elif process.configured and now_ns - process.begun_ns > LATE_NS and index not in self._warned_late:
            self._warned_late.add(index)
            _LOG.warning("%s is configured and waits for its publishers", process.spec.name)

    def _restarted(self, process: ManagedProcess) -> None:
        """Report that a node works again, and which readers its first messages may not reach."""
        name, missing = process.spec.name, process.missing
        self._launcher_node.report(
            "restarted", name, f"is active again, as process {process.pid}", missing=missing
        )
        if missing:
            _LOG.warning(
                "%s: restarted; readers not reconnected after %g s, may have missed messages: %s",
                name,
                WAIT_NS / 1e9,
                ", ".join(missing),
            )

    def _start_next(self, process: ManagedProcess, now_ns: int) -> None:
        """Start a failed node's next process, but never next to the one that has failed."""
        assert process.respawn_at_ns is not None
        if process.ended:
            process.reset(now_ns)
            self._launcher.spawn(process)
        elif now_ns > process.respawn_at_ns + KILL_NS:
            self._launcher.signal(process, signal.SIGKILL)

    def recover(self, index: int, cause: str, *numbers: signal.Signals) -> None:
        """Restart a node by its rule, with signals for a process that has not ended by itself."""
        if not self.restart(index, cause, *numbers):
            process = self._processes[index]
            raise NodeError(process.spec.name, f"{cause}{process.log_tail()}")

    def restart(self, index: int, cause: str, *numbers: signal.Signals) -> bool:
        """Plan a node's next process if its rule allows one; return whether it does."""
        process = self._processes[index]
        if process.respawn_at_ns is not None or process.given_up:
            return True
        dispensable = process.spec.run == RECORDER and not process.spec.params.get("required")
        if process.active and dispensable:
            self._give_up(index, cause)
            return True
        planned = process.plan_restart(monotonic_ns(), cause) if self._restarts else ""
        if planned:
            self.look_soon()
            self._liveness.forget(index)
            if not process.ended:
                self._launcher.signal(process, *numbers)
            self._launcher_node.report(
                "restarting", process.spec.name, planned, restart=process.restart_count
            )
            _LOG.warning("%s: %s", process.spec.name, planned)
        return bool(planned)

    def _give_up(self, index: int, cause: str) -> None:
        """Go on without a node that the graph does not need."""
        process = self._processes[index]
        process.given_up = True
        self._liveness.forget(index)
        self._launcher_node.report("recorder", process.spec.name, cause)
        _LOG.warning("%s: %s", process.spec.name, cause)

    # What nodes say

    def on_health(self, index: int, health: bytes) -> None:
        if self._liveness.record(index, decode(NodeHealth, health), monotonic_ns()):
            name = self._processes[index].spec.name
            self._processes[index].is_silent = False
            self._launcher_node.report("responsive", name, "answers again")
            _LOG.warning("%s: answers again", name)

    def _on_silence(self, index: int, silent_ns: int, now_ns: int) -> None:
        process = self._processes[index]
        name, silent_s = process.spec.name, silent_ns / 1e9
        if text := self._liveness.newly_silent(index, silent_ns):
            process.is_silent = True
            self._launcher_node.report("unresponsive", name, text, silent_s=silent_s)
            _LOG.warning("%s %s%s", name, text, process.log_tail())
        if silent_ns >= GIVE_UP_NS and process.spec.restart == "on_failure":
            # A stopped process wakes and reaches its safe state; one in a loop meets SIGKILL later.
            self.recover(index, f"was unresponsive for {silent_s:.0f} s", signal.SIGTERM, signal.SIGCONT)

    def expect_health(self, index: int) -> None:
        self._liveness.expect(index, monotonic_ns())

    def forget(self, index: int) -> None:
        """Expect no more of a node whose process has ended."""
        self._liveness.forget(index)
        self.look_soon()
