"""The engine of a swap: it sends a step's message, waits for the answer, or rolls back."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.lockstep.composition import Composition
from palp_core.graph.process.swap_messages import ToSwapped
from palp_core.graph.supervision.managed_process import ManagedProcess
from palp_core.graph.supervision.standby import Standby
from palp_core.graph.supervision.supervisor import FAREWELL_NS, Supervisor
from palp_core.graph.swap.swap import STEPS, CheckedSwap, SwapFailed

LARGE_BYTES = 1_000_000

OLD, NEW = "old", "new"
"""Where a step's message goes, and where its answer comes from."""

SwapHost = Supervisor | Composition
"""What has the nodes."""

Answer = TypeVar("Answer")


class Step(NamedTuple):
    """One row of the table: a message, and the answer that it waits for."""

    name: str  # of :data:`~palp_core.graph.swap.swap.STEPS`; a failure names it
    when: str  # in which swaps
    to: str  # where the message goes, and where the answer comes from
    send: Callable[[Any], ToSwapped | None]  # returns the message; None: it has done itself what is answered
    awaits: type[Any]  # kind of the answer
    # waits for the answer and judges it
    accept: "Callable[[Any, Step], object]" = lambda swap, step: swap.wait_for_answer(step)
    undo: ToSwapped | None = None  # message to the old node that takes the step back


class StepEngine:
    """Takes the steps of one swap."""

    def __init__(self, host: SwapHost, folder: Path, swap: CheckedSwap) -> None:
        self.index, self.step = swap.index, "start"
        self._host, self._folder, self._swap, self._request = host, folder, swap, swap.request
        self._old = host.processes[swap.index]
        self._successor = self._old  # before there is one
        self._standby: Standby | None = None  # the new node; from the commit on the old one
        self._undos: list[ToSwapped] = []
        self._answers: dict[type[Any], Any] = {}
        self._must_commit = self._committed = False
        self._extend_deadline()

    def take(self, step: Step) -> None:
        self.step = step.name if step.name in STEPS else self.step
        self._check_successor()
        if step.undo is not None:
            self._undos.append(step.undo)
        message = step.send(self)
        if message is not None:
            self._send(step.to, message)
        step.accept(self, step)

    @property
    def _new(self) -> Standby:
        assert self._standby is not None
        return self._standby

    def _extend_deadline(self) -> None:
        self._deadline_ns = monotonic_ns() + round(self._request.timeout_s * 1e9)

    def _answer(self, kind: type[Answer]) -> Answer:
        """Return the latest answer of a kind."""
        found: Answer = self._answers[kind]
        return found

    def _check_successor(self) -> None:
        """Fail if the new node has died, as long as the old one can go on."""
        new = self._standby
        if new is None or self._committed or self._must_commit:
            return
        if new.process.pid and new.process.has_died():  # how, the fork server is about to report
            self._wait_for(lambda: False, "its process has died")
        if new.failure:
            self._fail(new.failure)

    def _roll_back(self) -> None:
        """Leave all as it was; a new node has published nothing by itself."""
        host, new = self._host, self._standby
        if new is not None:
            host.standbys.kill(new)
        undos, self._undos = self._undos, []
        for undo in reversed(undos):
            self._send(OLD, undo)
        if new is not None:
            with contextlib.suppress(NodeError, GraphError):  # the swap's own failure is the news
                host.wait_until(lambda: new.process.ended, monotonic_ns() + FAREWELL_NS)
            for end in ("pub", "srv"):
                (self._folder / f"{new.process.place}.{end}").unlink(missing_ok=True)
        if self._old.handed_over:
            self._old.handed_over = False
            if self._old.ended and isinstance(host, Supervisor):
                host.recover(self.index, "its process ended while its successor failed")

    def _fail(self, text: str) -> NoReturn:
        raise SwapFailed(self._request.node, self.step, text)

    def _fail_in_time(self, missing: str, limit_s: float) -> NoReturn:
        size = self._state_bytes()
        state = f", with a state of {size / 1e6:.0f} MB" if size > LARGE_BYTES else ""
        self._fail(f"{missing} within {limit_s:g} s{state}")

    def _state_bytes(self) -> int:
        """Return how large the node's state was at the most."""
        answers = self._answers.values()
        found = [getattr(answer, "hand_over", getattr(answer, "tried", b"")) for answer in answers]
        return max(map(len, found), default=0)

    def _send(self, to: str, message: ToSwapped) -> None:
        if to == OLD:
            self._old.replies.clear()
        if (to == NEW) is not self._committed:
            self._host.standbys.send(self._new, message)
        else:
            self._host.send_if_connected(self.index, message)

    def wait_for_answer(self, step: Step, *, missing: str = "", may_refuse: bool = False) -> Any:
        """Wait for a step's answer; another kind is late, of a swap before that waited for it no longer."""
        answer = self._await(step.to, step.awaits, missing)
        self._answers[step.awaits] = answer
        if not may_refuse and (error := getattr(answer, "error", "")):
            self._fail(error)
        return answer

    def _await(self, node: str, kind: type[Answer], missing: str = "", limit_s: float = 0.0) -> Answer:
        missing = missing or f"the {node} node did not answer ({kind.__name__})"
        self._wait_for(lambda: self._found(node, kind) is not None, missing, limit_s)
        answer = self._found(node, kind)
        assert answer is not None
        self._process(node).replies.remove(answer)  # type: ignore[arg-type]
        return answer

    def _process(self, node: str) -> ManagedProcess:
        return self._old if node == OLD else self._successor

    def _found(self, node: str, kind: type[Answer]) -> Answer | None:
        """Return an answer; None before it has come."""
        return next((reply for reply in self._process(node).replies if isinstance(reply, kind)), None)

    def _wait_for(self, condition: Callable[[], bool], missing: str, limit_s: float = 0.0) -> None:
        """Wait for something; so long at the most, or as long as the swap may take."""
        old, new = self._old, self._standby

        def is_over() -> bool:
            gone = (old.ended and not old.handed_over) or old.respawn_at_ns is not None
            return condition() or gone or (new is not None and bool(new.failure))

        deadline_ns = monotonic_ns() + round(limit_s * 1e9) if limit_s else self._deadline_ns
        in_time = self._host.wait_until(is_over, deadline_ns)
        if condition():
            return
        if new is not None and new.failure:
            self._fail(new.failure)
        if not in_time:
            self._fail_in_time(missing, limit_s or self._request.timeout_s)
        self._fail("the old node has ended")
