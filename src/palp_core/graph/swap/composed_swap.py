"""A swap within one process: the same words on the same bytes as between two."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from palp_core.errors import GraphError, PalpError, in_words
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspect_classes
from palp_core.graph.lockstep.composition import Composition
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.process.control_messages import Done
from palp_core.graph.swap.swap import CheckedSwap, SwapFailed, SwapReport, unfit

_AT_ONCE = {"gap_s": 0.0, "duration_s": 0.0}  # simulated time stands still


class ComposedSwaps:
    """The swaps of a composed graph.

    Args:
        composition: Has the nodes.
        workspace: Folder that holds ``nodes/``.
        elapse: Lets so much simulated time go by.
    """

    def __init__(self, composition: Composition, workspace: Path, elapse: Callable[[int], None]) -> None:
        self._composition, self._workspace, self._elapse = composition, workspace, elapse

    def inspect_class(self, request: NodeClassRequest, timeout_s: float) -> NodeClass:
        """Say what a class declares; in this process, which has imported the workspace anyway."""
        del timeout_s
        return inspect_classes([request], self._workspace)[0]

    def swap(self, swap: CheckedSwap, now_ns: int) -> tuple[SwapReport, Done | None]:
        """Let a new executor take the place of a node's.

        Raises:
            SwapFailed: A step failed; the old node goes on.
        """
        composition, request = self._composition, swap.request
        old = composition.executor(swap.index)
        step = "configure"
        try:
            new, sent = composition.start_standby(swap.new)
            step = "state"
            running = _copied(old.succession.copy())
            if why := unfit(running, swap):
                raise GraphError(why)
            new.succession.fitting(running, request.params)
            found: dict[str, Any] = {}
            if request.shadow_s:
                step = "shadow"
                new.succession.take_over(_copied(running), request.params)
                found = self._shadow(swap, new, sent, running)
                now_ns += round(request.shadow_s * 1e9)
            if request.dry_run:
                new.succession.leave()
                return swap.report(at_ns=now_ns, **_AT_ONCE, held=0, shadow=found), None
            step = "take over"
            handed_frames, handed = composition.hand_over(swap.index)
            new.succession.take_over(_copied(handed), request.params)
        except Exception as error:
            old.succession.resume()
            if isinstance(error, SwapFailed):
                raise
            text = in_words(error) if isinstance(error, PalpError) else f"{type(error).__name__}: {error}"
            raise SwapFailed(request.node, step, text) from error
        record = {
            "at_s": now_ns / 1e9,
            "before": swap.old.run,
            "after": swap.new.run,
            "gap_s": 0.0,
            "held": len(new.inbox),
        }
        new.swaps.append(record)
        done = composition.promote(swap.index, new, [*handed_frames, *sent])
        old.succession.leave()
        return swap.report(at_ns=now_ns, **_AT_ONCE, held=len(new.inbox), shadow=found), done

    def _shadow(
        self, swap: CheckedSwap, new: Executor, sent: list[bytes], running: HandOver
    ) -> dict[str, Any]:
        """Let both work for a while, and only the old one be heard; return how they compare."""
        comparison = swap.comparison(running.published)
        self._composition.shadow = (swap.index, new, sent, comparison)
        try:
            self._elapse(round(swap.request.shadow_s * 1e9))
        finally:
            self._composition.shadow = None
            sent.clear()
        new.succession.pause()
        new.succession.paused = False
        new.inbox.clear()
        return comparison.report()


def _copied(hand_over: HandOver) -> HandOver:
    """Return a hand-over as it is after a journey between two processes."""
    return decode_any(HandOver, encode_any(hand_over))
