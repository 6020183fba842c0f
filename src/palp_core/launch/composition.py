"""All nodes of a lockstep graph in this process; messages are encoded and decoded all the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from palp_core.runtime.birth import load_class
from palp_core.runtime.clock import SimClock
from palp_core.runtime.commands import CHANGING, NodeCommands
from palp_core.runtime.executor import Executor
from palp_core.runtime.lifecycle import Transition
from palp_core.runtime.link import Done, Round
from palp_core.runtime.lockstep_main import follow_round
from palp_core.runtime.spec import NodeSpec
from palp_core.runtime.zmq_bus import Broadcast

__all__ = ["Composition"]

POLL_ROUNDS = 32  # asking a socket costs as much as a message; tools wait a few ms more


class Composition:
    """A crew in memory.

    Args:
        specs: The nodes in graph order.
        workspace: Folder that holds ``nodes/``.
        broadcast: Where tools listen; None if nobody can.

    Raises:
        GraphError: A class or its parameters do not fit.
        NodeError: A node could not be configured.
    """

    def __init__(self, specs: Sequence[NodeSpec], workspace: str, broadcast: Broadcast | None = None) -> None:
        self.names = [spec.name for spec in specs]
        self._clock = SimClock()
        self._frames: list[bytes] = []
        self._broadcast = broadcast
        self._round_count = 0
        self._executors = [
            Executor(load_class(spec.run, workspace), spec, self._clock, self._send) for spec in specs
        ]
        for executor in self._executors:
            executor.transition(Transition.CONFIGURE)
            if broadcast is not None:
                broadcast.offer(executor.outlets.values())
                broadcast.answer(executor.name, NodeCommands(executor).operations(), CHANGING)

    def _send(self, frame: bytes) -> None:
        self._frames.append(frame)
        if self._broadcast is not None and self._broadcast.heard:
            self._broadcast.send(frame)

    def _done(self, executor: Executor) -> Done:
        frames, self._frames = self._frames, []
        due_ns = executor.next_due_ns()
        return Done(frames, -1 if due_ns is None else due_ns, executor.exit_code)

    def activate(self, index: int) -> Done:
        """Activate one node."""
        self._executors[index].transition(Transition.ACTIVATE)
        return self._done(self._executors[index])

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, one after the other."""
        self._round_count += 1
        if self._broadcast is not None and self._round_count % POLL_ROUNDS == 0:
            self._broadcast.poll()
        replies = {}
        for index, message in rounds.items():
            self._clock.set(message.now_ns)
            if self._broadcast is not None and self._broadcast.waiting:
                self._broadcast.perform(self.names[index])
            follow_round(self._executors[index], self._clock, message)
            replies[index] = self._done(self._executors[index])
        return replies

    def knocks(self) -> set[int]:
        """Return the nodes for which a command from outside waits."""
        waiting = self._broadcast.waiting if self._broadcast is not None else ()
        return {self.names.index(name) for name in waiting}

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and end it."""
        self._clock.set(now_ns)
        self._executors[index].transition(Transition.SHUTDOWN)
        return self._done(self._executors[index])
