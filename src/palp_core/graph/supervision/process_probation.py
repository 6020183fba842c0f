"""A node's process in lockstep on probation, while its predecessor's is on standby."""

from collections.abc import Collection
from typing import TYPE_CHECKING

import msgspec

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.node.spec import HUNG_S
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.process.probation import LockstepProbation
from palp_core.graph.process.swap_messages import RequestReport, Resume, WorkReport
from palp_core.graph.supervision.standby import Standby

if TYPE_CHECKING:
    from palp_core.graph.supervision.supervisor import Supervisor


class ProcessProbation(LockstepProbation):
    """Rounds of a process that may fail, die or hang.

    Args:
        supervisor: Has the processes.
        former: The predecessor's.
        index: Number of the node.
        inputs: Topics that the successor reads.
        enough: How many handlers have to run well.
        can_roll_back: The predecessor can take the successor's state.
    """

    def __init__(
        self,
        supervisor: "Supervisor",
        former: Standby,
        index: int,
        inputs: Collection[str],
        enough: int,
        *,
        can_roll_back: bool,
    ) -> None:
        super().__init__(index, inputs, enough, can_roll_back=can_roll_back)
        self._supervisor, self._former = supervisor, former

    def _attempt(self, message: Round) -> Done | None:
        latest_ns = self._latest_ns()
        replies = self._supervisor.work_together(
            {self.index: message}, lambda: bool(self.failure) or monotonic_ns() > latest_ns
        )
        self._note_hang(answered=self.index in replies)
        return replies.get(self.index)

    def _report(self) -> WorkReport | None:
        supervisor, index = self._supervisor, self.index
        replies = supervisor.processes[index].replies
        replies.clear()
        supervisor.send_if_connected(index, RequestReport())

        def report() -> WorkReport | None:
            return next((reply for reply in replies if isinstance(reply, WorkReport)), None)

        supervisor.wait_until(lambda: report() is not None or bool(self.failure), self._latest_ns())
        self._note_hang(answered=report() is not None)
        return report()

    @staticmethod
    def _latest_ns() -> int:
        return monotonic_ns() + round(HUNG_S["sim"] * 1e9)

    def _note_hang(self, *, answered: bool) -> None:
        if not (answered or self.failure):
            self.failure = f"a handler of it did not return within {HUNG_S['sim']:g} s"

    def _roll_back(self) -> None:
        supervisor, former = self._supervisor, self._former
        supervisor.promote(self.index, former)
        supervisor.processes[self.index].handed_over = False
        supervisor.standbys.end(former)
        if self._last_report is not None:
            supervisor.send_if_connected(self.index, msgspec.structs.replace(self._last_report, frames=[]))
        supervisor.send_if_connected(self.index, Resume())

    def _work_now(self, message: Round) -> Done:
        return self._supervisor.work_together({self.index: message})[self.index]
