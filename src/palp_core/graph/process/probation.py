"""A successor is tried on the last messages before it takes over, and reports what it does on probation."""

from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError, NodeError, SchemaMismatch, in_words
from palp_core.graph.messages.message import encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
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
        """Report what has been done, at a handler boundary.

        Raises:
            NodeError: The node is done, or its own class cannot read the state that it has.
        """
        executor = self._executor
        if executor.exit_code is not None:
            raise NodeError(executor.name, "it called finish() on probation")
        executor.journal.flush(executor.now_ns())
        self._reported = executor.ends.run_count()
        frames = list(self.frames)
        self.frames.clear()
        written = executor.succession.snapshot()  # the predecessor remembers the frames that it publishes
        try:
            executor.succession.fitting(written, {})
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
            list(executor.ends.timers),
        )


def try_hand_over(executor: Executor, hand_over: HandOver, changes: Mapping[str, Any]) -> HandOver:
    """Let a node handle the last message of every input on a copy of a predecessor's state, and be as before.

    The caller keeps back what is published meanwhile.

    Returns:
        The state that this has led to, written down as for a successor.

    Raises:
        GraphError: A handler failed, or parameters do not fit.
        SchemaMismatch: The state does not fit.
        NodeError: ``on_resume`` failed.
    """
    executor.succession.take_over(msgspec.structs.replace(hand_over, inbox=[]), changes)
    for name, payload in hand_over.latest if hand_over.active else ():
        for subscription in executor.ends.subscriptions.get(name, []):
            message = subscription.decode(payload)
            subscription.last = (executor.now_ns(), message)
            try:
                subscription.handler(executor.node, message)
            except (Exception, SystemExit) as error:
                handler = subscription.handler.__name__
                text = f"{handler} failed when it was tried on the last message of {name}"
                raise GraphError(f"{text}: {in_words(error)}") from error
    found = executor.succession.snapshot()
    executor.succession.step_back()
    return found
