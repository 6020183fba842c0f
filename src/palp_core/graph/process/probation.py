"""A successor is tried on the last messages before it takes over, and reports what it does on probation."""

from palp_core.errors import NodeError, SchemaMismatch
from palp_core.graph.messages.message import encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.process.swap_messages import HANDLER, WorkReport


class WorkReporter:
    """What a successor has done since it last reported.

    Attributes:
        frames: What it has published and not reported.
    """

    def __init__(self, executor: Executor) -> None:
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
        written = executor.snapshot()  # the predecessor remembers the frames that it publishes
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
