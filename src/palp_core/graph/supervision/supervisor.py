"""Start every node as its own process, watch it, restart it by rule, and end all of them for certain."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.process.channel import (
    Activate,
    Done,
    LinkClosed,
    Shutdown,
    ToNode,
)
from palp_core.graph.process.shadow import Comparison
from palp_core.graph.supervision.crew import ProcessCrew
from palp_core.graph.supervision.managed_process import Member
from palp_core.graph.supervision.restarts import READY_NS
from palp_core.graph.supervision.standby import Understudy

PATIENCE_S = 10.0
_LOG = logging.getLogger("palp.supervisor")


class Supervisor(ProcessCrew):
    """A crew of processes, from their start to the end of the run.

    Attributes:
        shadow: In lockstep, the number of a node, who works beside it unheard, and how they compare.
    """

    shadow: tuple[int, Understudy, Comparison] | None = None

    def follow(self, until: Callable[[], bool], deadline_ns: int | None = None) -> bool:
        """Handle what happens until something is so; return whether it is, when the time is over.

        Raises:
            NodeError: A node failed.
        """
        while not until():
            now_ns = monotonic_ns()
            left_s = 1.0 if deadline_ns is None else (deadline_ns - now_ns) / 1e9
            if left_s <= 0.0:
                return False
            if self.start_ns:
                self._keeper.turn(now_ns)
                left_s = min(left_s, self._keeper.patience_s(now_ns))
            self._pump(min(left_s, 1.0))
        return True

    # Start

    def start(self) -> None:
        """Start every node; return when all are configured and all edges matched.

        Raises:
            NodeError: A node failed or did not get ready in time.
        """
        for member in self.members:
            self.spawn(member)
        self._await(lambda m: m.configured, "configured")
        self._await(lambda m: m.matched, "matched with its publishers")

    def _await(self, ready: Callable[[Member], bool], what: str) -> None:
        deadline_ns = monotonic_ns() + READY_NS
        while late := next((member for member in self.members if not ready(member)), None):
            if monotonic_ns() > deadline_ns:
                text = f"was not {what} within {READY_NS // 10**9} s{late.last_words()}"
                raise NodeError(late.spec.name, text)
            self._pump(1.0)

    # Lockstep crew

    def activate(self, index: int) -> Done:
        """Activate one node."""
        return self.work({index: Activate(self.start_ns)})[index]

    def knocks(self) -> set[int]:
        """Return the numbers of the nodes for which commands have come since this was last asked."""
        knocks, self._knocks = self._knocks, set()
        return knocks

    def work(self, rounds: Mapping[int, ToNode]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, in parallel; return what each has done."""
        for index, message in rounds.items():
            self._send(index, message)
        if self.shadow is not None and self.shadow[0] in rounds:
            self._work_unheard(rounds[self.shadow[0]])
        asked_ns = monotonic_ns()
        while len(self._replies) < len(rounds):
            self._pump(PATIENCE_S)
            if monotonic_ns() - asked_ns > PATIENCE_S * 1e9:
                late = ", ".join(self.names[index] for index in rounds if index not in self._replies)
                _LOG.warning("still waiting for %s; Ctrl-C ends the run", late)
                asked_ns = monotonic_ns()
        replies, self._replies = self._replies, {}
        if self.shadow is not None and self.shadow[0] in replies:
            for frame in replies[self.shadow[0]].frames:
                self.shadow[2].old(frame)
        return replies

    def _work_unheard(self, message: ToNode) -> None:
        """Let the understudy of a node do the same as the node, and compare."""
        assert self.shadow is not None
        _, understudy, comparison = self.shadow
        understudy.said.clear()
        self.understudies.send(understudy, message)
        self.follow(lambda: bool(understudy.said) or bool(understudy.failure))
        for done in understudy.said:
            if isinstance(done, Done):
                for frame in done.frames:
                    comparison.new(frame)

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and let it end; :meth:`close` is for one that does not answer."""
        member = self.members[index]
        self._patience.begin()
        if not self._lines.connected(index) or member.ended:
            return Done([], -1, None)
        self._replies.clear()
        with contextlib.suppress(NodeError, GraphError, LinkClosed):
            self._lines.send(index, Shutdown(now_ns))
            while not (member.done or member.ended) and not self._patience.over:
                self._pump(0.2)
        return self._replies.pop(index, Done([], -1, None))

    # Wall clock

    def run_wall(self, until_ns: int | None = None, start_ns: int | None = None) -> int:
        """Activate in graph order, then watch until the run ends; return the exit code.

        Args:
            until_ns: When to end, on the graph's clock.
            start_ns: The graph's start on the machine's monotonic clock; now by default.

        Raises:
            NodeError: A node failed and its rule does not restart it.
        """
        self.start_ns = monotonic_ns() if start_ns is None else start_ns
        while self.exit_code is None:
            now_ns = monotonic_ns()
            left_s = 1.0 if until_ns is None else (until_ns + self.start_ns - now_ns) / 1e9
            if left_s <= 0.0:
                return 0
            self._keeper.turn(now_ns)
            self._pump(min(left_s, self._keeper.patience_s(now_ns)))
            self.between()
        return self.exit_code
