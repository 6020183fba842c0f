"""The engine of a swap between two processes: it sends a message, waits for the answer, or rolls back."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.process.swap_messages import ToSwapped
from palp_core.graph.supervision.managed_process import ManagedProcess
from palp_core.graph.supervision.standby import Standby
from palp_core.graph.supervision.supervisor import Supervisor
from palp_core.graph.swap.swap import STEPS, CheckedSwap, SwapFailed

FAREWELL_NS = 1_000_000_000
LARGE_BYTES = 1_000_000

OLD, NEW = "old", "new"
"""Where a step's message goes, and where its answer comes from."""

Answer = TypeVar("Answer")


class Step(NamedTuple):
    """One row of the table: a message, and the answer that it waits for.

    Attributes:
        name: Of :data:`~palp_core.graph.swap.swap.STEPS`; a failure names it.
        when: In which swaps.
        to: Where the message goes, and where the answer comes from.
        send: Returns the message; None: it has done itself what is answered.
        awaits: Kind of the answer.
        accept: Waits for the answer and judges it.
        undo: Message to the old process that takes the step back.
    """

    name: str
    when: str
    to: str
    send: Callable[[Any], ToSwapped | None]
    awaits: type[Any]
    accept: "Callable[[Any, Step], object]" = lambda swap, step: swap.wait_for_answer(step)
    undo: ToSwapped | None = None


class StepEngine:
    """Takes the steps of one swap.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        swap: What is replaced by what.

    Attributes:
        step: The name of the current step.
    """

    def __init__(self, supervisor: Supervisor, folder: Path, swap: CheckedSwap) -> None:
        self.step = "start"
        self._supervisor, self._folder, self._swap = supervisor, folder, swap
        self._index, self._request = swap.index, swap.request
        self._old = supervisor.processes[swap.index]
        self._successor = self._old  # before there is one
        self._standby: Standby | None = None  # the new process; from the commit on the old one
        self._undos: list[ToSwapped] = []
        self._answers: dict[type[Any], Any] = {}
        self._must_commit = self._committed = False
        self._extend_deadline()

    @property
    def _new(self) -> Standby:
        assert self._standby is not None
        return self._standby

    def _extend_deadline(self) -> None:
        self._deadline_ns = monotonic_ns() + round(self._request.timeout_s * 1e9)

    def take(self, step: Step) -> None:
        """Take one step: send its message, wait for the answer, accept it."""
        self.step = step.name if step.name in STEPS else self.step
        self._check_successor()
        if step.undo is not None:
            self._undos.append(step.undo)
        message = step.send(self)
        if message is not None:
            self._send(step.to, message)
        step.accept(self, step)

    def _answer(self, kind: type[Answer]) -> Answer:
        """Return the latest answer of a kind."""
        found: Answer = self._answers[kind]
        return found

    def _check_successor(self) -> None:
        """Fail if the new process has died, as long as the old one can go on."""
        new = self._standby
        if new is None or self._committed or self._must_commit:
            return
        if new.process.pid and new.process.has_died():  # how, the fork server is about to report
            self._wait_for(lambda: False, "its process has died")
        if new.failure:
            self._fail(new.failure)

    def _roll_back(self) -> None:
        """Leave all as it was; a new process has published nothing by itself."""
        supervisor, new = self._supervisor, self._standby
        if new is not None:
            supervisor.standbys.kill(new)
        for undo in reversed(self._undos):
            self._send(OLD, undo)
        if new is not None:
            with contextlib.suppress(NodeError, GraphError):  # the swap's own failure is the news
                supervisor.wait_until(lambda: new.process.ended, monotonic_ns() + FAREWELL_NS)
            for end in ("pub", "srv"):
                (self._folder / f"{new.process.place}.{end}").unlink(missing_ok=True)
        if self._old.handed_over:
            self._old.handed_over = False
            if self._old.ended:
                supervisor.recover(self._index, "its process ended while its successor failed")

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
            self._supervisor.standbys.send(self._new, message)
        else:
            self._supervisor.send_if_connected(self._index, message)

    def wait_for_answer(self, step: Step, *, missing: str = "", may_refuse: bool = False) -> Any:
        """Wait for a step's answer; another kind is late, of a swap before that waited for it no longer.

        Raises:
            SwapFailed: There is none, or it has an error.
        """
        missing = missing or f"the {step.to} node did not answer ({step.awaits.__name__})"
        self._wait_for(lambda: self._found(step) is not None, missing)
        answer = self._found(step)
        self._process(step.to).replies.remove(answer)
        self._answers[step.awaits] = answer
        if not may_refuse and (error := getattr(answer, "error", "")):
            self._fail(error)
        return answer

    def _process(self, node: str) -> ManagedProcess:
        return self._old if node == OLD else self._successor

    def _found(self, step: Step) -> Any:
        """Return a step's answer; None before it has come."""
        replies = self._process(step.to).replies
        return next((reply for reply in replies if isinstance(reply, step.awaits)), None)

    def _wait_for(self, condition: Callable[[], bool], missing: str) -> None:
        """Wait for something.

        Raises:
            SwapFailed: One of the processes has ended, or the time is over.
        """
        old, new = self._old, self._standby

        def is_over() -> bool:
            gone = (old.ended and not old.handed_over) or old.respawn_at_ns is not None
            return condition() or gone or (new is not None and bool(new.failure))

        in_time = self._supervisor.wait_until(is_over, self._deadline_ns)
        if condition():
            return
        if new is not None and new.failure:
            self._fail(new.failure)
        if not in_time:
            self._fail_in_time(missing, self._request.timeout_s)
        self._fail("the old node has ended")
