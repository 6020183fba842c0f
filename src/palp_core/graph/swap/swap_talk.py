"""What a swap says to its two processes, and how it waits for their answers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.process.line import Line
from palp_core.graph.process.swap_messages import (
    HandedIn,
    HandIn,
)
from palp_core.graph.supervision.standby import Understudy
from palp_core.graph.supervision.supervisor import Supervisor
from palp_core.graph.swap.swap import Replacement, SwapFailed

Answer = TypeVar("Answer", bound=Line)


class SwapTalk:
    """One swap's words with the process that has the node's part and the one that is to get it.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        replacement: What is replaced by what.
        now_ns: Time on the graph's clock.
        elapse: Lets so much simulated time go by.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        folder: Path,
        replacement: Replacement,
        now_ns: int,
        elapse: Callable[[int], None],
    ) -> None:
        self._elapse = elapse
        self._supervisor, self._folder, self._replacement = supervisor, folder, replacement
        self._index, self._now_ns = replacement.index, now_ns
        self._old = supervisor.members[replacement.index]
        self._begun_ns = monotonic_ns()
        self._deadline_ns = self._begun_ns + round(replacement.request.timeout_s * 1e9)
        self._step = "start"
        self._new: Understudy | None = None
        self._announced = self._paused = False
        self._found: dict[str, Any] = {}

    def _fail(self, text: str) -> NoReturn:
        raise SwapFailed(self._replacement.request.node, self._step, text)

    def _hand_in(self, after: dict[str, tuple[int, int]], *, pause: bool) -> HandedIn:
        self._say_old(HandIn(after, pause))
        return self._from_old(HandedIn)

    def _say_old(self, line: Line) -> None:
        self._supervisor.answers.pop(self._index, None)
        self._supervisor.say(self._index, line)

    def _say_new(self, line: Line) -> None:
        assert self._new is not None
        self._new.said.clear()
        self._supervisor.understudies.send(self._new, line)

    def _from_old(self, kind: type[Answer]) -> Answer:
        answers, index = self._supervisor.answers, self._index
        self._until(lambda: index in answers, f"the old node did not answer ({kind.__name__})")
        answer = answers.pop(index)
        assert isinstance(answer, kind)
        return answer

    def _from_new(self, kind: type[Answer]) -> Answer:
        new = self._new
        assert new is not None

        def fitting() -> list[Answer]:
            return [said for said in new.said if isinstance(said, kind)]

        self._until(lambda: bool(fitting()), f"the new node did not answer ({kind.__name__})")
        return fitting()[0]

    def _until(self, so: Callable[[], bool], otherwise: str) -> None:
        """Wait for something.

        Raises:
            SwapFailed: One of the processes has ended, or the time is over.
        """
        old, new = self._old, self._new

        def over() -> bool:
            gone = (old.ended and not old.handed_in) or old.respawn_at_ns is not None
            return so() or gone or (new is not None and bool(new.failure))

        in_time = self._supervisor.follow(over, self._deadline_ns)
        if so():
            return
        if not in_time:
            self._fail(f"{otherwise} within {self._replacement.request.timeout_s:g} s")
        if new is not None and new.failure:
            self._fail(new.failure)
        self._fail("the old node has ended")
