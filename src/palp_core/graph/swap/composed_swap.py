"""A swap within one process: the same words on the same bytes as between two."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palp_core.errors import GraphError, PalpError, in_words
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspect_classes
from palp_core.graph.lockstep.composed_probation import ComposedProbation
from palp_core.graph.lockstep.composition import Composition
from palp_core.graph.lockstep.simulated_time import SimulatedTime
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.process.control_messages import Done
from palp_core.graph.swap.swap import CheckedSwap, SwapFailed, SwapReport, why_not_swappable

_AT_ONCE = {"gap_s": 0.0, "duration_s": 0.0}  # simulated time does not pass


class ComposedSwaps:
    """The swaps of a composed graph.

    Args:
        composition: Has the nodes.
        workspace: Folder that holds ``nodes/``.
        time: Simulated time.
    """

    step = ""  # it is done between two instants, when nothing can ask

    def __init__(self, composition: Composition, workspace: Path, time: SimulatedTime) -> None:
        self._composition, self._workspace, self._time = composition, workspace, time

    def inspect_class(self, request: NodeClassRequest, timeout_s: float) -> NodeClass:
        """Return what a class declares; in this process, which has imported the workspace anyway."""
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
            on_probation = swap.probation.run_count > 0 and old.is_active
            running = _copied(old.full_snapshot(with_latest=swap.try_out))
            if why := why_not_swappable(running, swap):
                raise GraphError(why)
            new.fitting(running, request.params)
            can_roll_back = on_probation and self._try(old, new, running, request.params)
            sent.clear()
            found: dict[str, Any] = {}
            if request.shadow_s:
                step = "shadow"
                new.take_over(_copied(running), request.params)
                found = self._shadow(swap, new, sent, running)
                now_ns += round(request.shadow_s * 1e9)
            if request.dry_run:
                new.leave()
                return swap.report(at_ns=now_ns, **_AT_ONCE, held=0, shadow=found), None
            step = "take over"
            handed_frames, handed = composition.hand_over(swap.index)
            new.take_over(_copied(handed), request.params)
        except Exception as error:
            old.resume()
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
        held = len(new.inbox)
        if on_probation:
            composition.promote(swap.index, new)
            probation = self._prove(swap, old, handed_frames, sent, can_roll_back=can_roll_back)
            proof: dict[str, Any] = {"proven": probation.proof_count, "proven_by": probation.proof}
            done = None
        else:
            proof, done = {}, composition.promote(swap.index, new, [*handed_frames, *sent])
        old.leave()
        return swap.report(at_ns=now_ns, **_AT_ONCE, held=held, shadow=found, **proof), done

    @staticmethod
    def _try(old: Executor, new: Executor, running: HandOver, params: Mapping[str, Any]) -> bool:
        """Try the new node on the last messages; return whether the old one could take its state back."""
        tried = _copied(new.dry_run(running, params))
        try:
            old.fitting(tried, {})
        except Exception:  # noqa: BLE001 - migrate and adopt are the user's
            return False
        return True

    def _prove(
        self, swap: CheckedSwap, old: Executor, frames: list[bytes], sent: list[bytes], *, can_roll_back: bool
    ) -> ComposedProbation:
        """Let simulated time pass while the old node is on standby; return how that went.

        Raises:
            SwapFailed: The new node failed; the old one goes on.
        """
        composition, wanted, index = self._composition, swap.probation, swap.index
        inputs = swap.new.inputs.values()
        new = composition.executor(index)
        probation = ComposedProbation(
            composition, old, index, inputs, wanted.run_count, can_roll_back=can_roll_back
        )
        composition.probation = probation
        due_ns = new.next_due_ns()
        taken = Done(list(sent), -1 if due_ns is None else due_ns, new.exit_code)
        sent.clear()
        try:
            first = probation.begin(frames, taken)
            composition.publish(first.frames)
            self._time.pass_probation(probation, first, wanted.longest_s, swap.request.timeout_s)
        finally:
            composition.probation = None
        if probation.failure:
            raise SwapFailed(swap.request.node, "probation", probation.failure)
        return probation

    def _shadow(
        self, swap: CheckedSwap, new: Executor, sent: list[bytes], running: HandOver
    ) -> dict[str, Any]:
        """Let both work for a while, and only the old one publish; return how they compare."""
        comparison = swap.comparison(running.published)
        self._composition.shadow = (swap.index, new, sent, comparison)
        try:
            self._time.elapse(round(swap.request.shadow_s * 1e9))
        finally:
            self._composition.shadow = None
            sent.clear()
        new.step_back()
        new.inbox.clear()
        return comparison.report()


def _copied(hand_over: HandOver) -> HandOver:
    """Return a hand-over as it is after a journey between two processes."""
    return decode_any(HandOver, encode_any(hand_over))
