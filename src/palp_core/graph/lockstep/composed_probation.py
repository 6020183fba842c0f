"""A composed node on probation, while its predecessor is on standby in the same process."""

from collections.abc import Callable, Collection

import msgspec

from palp_core.errors import NodeError
from palp_core.graph.lockstep.composition import Composition
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.process.lockstep_loop import follow_round
from palp_core.graph.process.probation import LockstepProbation, WorkReporter
from palp_core.graph.process.swap_messages import WorkReport


class ComposedProbation(LockstepProbation):
    """Rounds that may fail; one that does not return holds up the run, as everywhere in one process.

    Args:
        composition: Has the nodes, the successor in its place.
    """

    def __init__(
        self,
        composition: Composition,
        former: Executor,
        index: int,
        inputs: Collection[str],
        enough: int,
        *,
        can_roll_back: bool,
    ) -> None:
        super().__init__(index, inputs, enough, can_roll_back=can_roll_back)
        self._composition, self._former = composition, former
        self._reporter = WorkReporter(composition.executor(index), reports=False)
        self._reporter.begin()

    def _try(self, message: Round) -> Done | None:
        done = super()._try(message)
        self._composition.publish(() if done is None else done.frames)
        return done

    def _attempt(self, message: Round) -> Done | None:
        composition, index = self._composition, self.index
        return self._work_unread(
            lambda: follow_round(composition.executor(index), composition.clock, message)
        )

    def _work_unread(self, work: Callable[[], None]) -> Done | None:
        try:
            return self._composition.work_unread(self.index, work)
        except NodeError as error:
            self.failure = str(error).removeprefix(f"{error.node}: ")
            return None

    def _report(self) -> WorkReport | None:
        reports: list[WorkReport] = []
        done = self._work_unread(lambda: reports.append(self._reporter.report()))
        if done is None:
            return None
        try:
            self._former.fitting(decode_any(HandOver, reports[0].hand_over), {})
        except Exception:  # noqa: BLE001 - migrate and adopt are the user's
            self._can_roll_back = False  # it has to go on from here
        return msgspec.structs.replace(reports[0], frames=done.frames)

    def _roll_back(self) -> None:
        self._composition.promote(self.index, self._former)
        if self._last_report is None:
            self._former.resume()
        else:
            self._former.take_back(decode_any(HandOver, self._last_report.hand_over), self._last_report.ends)

    def _work_now(self, message: Round) -> Done:
        return self._composition.work_alone(self.index, message)
