"""The first work of a successor, from which its predecessor can go on if a handler of it fails."""

from abc import ABC, abstractmethod
from collections.abc import Collection

import msgspec

from palp_core.errors import NodeError, SchemaMismatch
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.messages.message import encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.process.swap_messages import HANDLER, WorkReport


class WorkReporter:
    """What a successor has done since it last reported.

    Args:
        reports: Its predecessor publishes what it reports; else it reports after each of its rounds, which
            are published as a whole or not at all.
    """

    def __init__(self, executor: Executor, *, reports: bool) -> None:
        self.reports = reports
        self.frames: list[bytes] = []
        self._executor = executor
        self._begun_at = self._reported = 0

    def begin(self) -> None:
        """Count handlers from here on: the node has taken over."""
        self._begun_at = self._reported = self._executor.ends.run_count()

    def has_news(self, handler_count: int = 0) -> bool:
        """Return whether there is something to report, and so many handlers have run."""
        run_count = self._executor.ends.run_count()
        is_new = bool(self.frames) or run_count != self._reported
        return is_new and run_count - self._begun_at >= handler_count

    def report(self, *, last: bool = False) -> WorkReport:
        """Report what has been done, at a handler boundary."""
        executor = self._executor
        if executor.exit_code is not None:
            raise NodeError(executor.name, "it called finish() on probation")
        executor.journal.flush(executor.now_ns())
        self._reported = executor.ends.run_count()
        frames = list(self.frames)
        self.frames.clear()
        # the predecessor remembers the frames that it publishes; in lockstep it publishes none
        written = executor.snapshot() if self.reports else executor.full_snapshot()
        try:
            executor.fitting(written, {})
        except SchemaMismatch as error:
            raise NodeError(executor.name, f"its state is not what its class declares: {error}") from error
        run_count, counter = self._reported - self._begun_at, executor.node.proven_by
        return WorkReport(
            encode_any(written),
            frames,
            run_count,
            getattr(executor.node, counter) if counter else run_count,
            counter.removesuffix("_count") or HANDLER,
            last,
            list(executor.ends.timed),
        )


class LockstepProbation(ABC):
    """The rounds of a successor while its predecessor is on standby: each is published whole or not at all.

    Args:
        inputs: Topics that the successor reads; what else comes waits for the predecessor.
        enough: How many handlers, or what else proves the node, have to go well.
        can_roll_back: The predecessor can take the successor's state; else one round has to go well.

    Attributes:
        failure: Why the predecessor goes on; "" if it need not.
        proof_count: How much of what proves the node went well.
        confirmed: Enough have: whatever fails now is a failure of the node.
    """

    def __init__(self, index: int, inputs: Collection[str], enough: int, *, can_roll_back: bool) -> None:
        self.index = index
        self.failure = ""
        self.proof_count, self.proof = 0, HANDLER
        self.confirmed = False
        self._inputs = {name.encode() for name in inputs}
        self._enough, self._can_roll_back = enough, can_roll_back
        self._passed_by: list[bytes] = []
        self._held: list[bytes] = []
        self._last_report: WorkReport | None = None
        self.rolled_back = False

    @property
    def over(self) -> bool:
        return self.confirmed or bool(self.failure)

    def begin(self, frames: list[bytes], done: Done) -> Done:
        """Return what both have published at the change of hands, as far as readers may have it.

        Args:
            frames: The predecessor's.
            done: The successor's, which is kept back until it cannot be taken back any more.
        """
        report = self._report() if self._can_roll_back else None
        if report is None:
            self._held = done.frames
            return msgspec.structs.replace(done, frames=frames)
        self._last_report = report
        return msgspec.structs.replace(done, frames=[*frames, *done.frames, *report.frames])

    def work(self, message: Round) -> Done:
        """Let the successor do its part of a round; if it fails, the predecessor instead."""
        if not self.failure:
            own = [frame for frame in message.frames if topic_of(frame) in self._inputs]
            if self.confirmed:
                return self._work_now(Round(message.now_ns, own))
            if (done := self._try(Round(message.now_ns, own))) is not None:
                self._passed_by += [frame for frame in message.frames if topic_of(frame) not in self._inputs]
                return done
        if not self.rolled_back:
            self.rolled_back = True
            self._roll_back()
        passed_by, self._passed_by = self._passed_by, []
        return self._work_now(Round(message.now_ns, [*passed_by, *message.frames]))

    def _try(self, message: Round) -> Done | None:
        """Let the successor work; None if it failed."""
        done = self._attempt(message)
        report = self._report() if done is not None else None
        if done is None or report is None:
            return None
        self._last_report = report
        self.proof_count, self.proof = report.proof_count, report.proof
        self.confirmed = self.proof_count >= self._enough or not self._can_roll_back
        held, self._held = self._held, []
        return msgspec.structs.replace(done, frames=[*held, *done.frames, *report.frames])

    @abstractmethod
    def _attempt(self, message: Round) -> Done | None:
        """Let the successor work, unread; None if it failed, and :attr:`failure` is why."""

    @abstractmethod
    def _report(self) -> WorkReport | None:
        """Let the successor report; None if it failed."""

    @abstractmethod
    def _roll_back(self) -> None:
        """Give the predecessor the node's part, from where the successor last went well."""

    @abstractmethod
    def _work_now(self, message: Round) -> Done:
        """Let the node work that has the part."""
