"""Lockstep simulated time: rounds at an instant, then a leap to the next due timer.

A round delivers exactly the messages of the round before; within it each node runs its due timers in
declaration order, then consumes messages by (topic, sequence). So a run is a function of graph and seed.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from palp_core.errors import GraphError
from palp_core.graph.messages.frame import sequence_of, topic_of
from palp_core.graph.process.control_messages import Done, Round

MAX_ROUNDS = 1000

Observer = Callable[[int, bytes], None]
"""Is shown every published frame in its deterministic order, with the time of its round."""


class LockstepNodes(Protocol):
    """The nodes of a lockstep graph, numbered in graph order."""

    @property
    def names(self) -> Sequence[str]:
        """Running names."""

    def activate(self, index: int) -> Done:
        """Activate one node."""

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, in parallel where they can."""

    def pending_commands(self) -> set[int]:
        """Return the nodes for which a command from outside waits, since last asked."""

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and end it."""


class Conductor:
    """Drives nodes through simulated time."""

    def __init__(
        self,
        nodes: LockstepNodes,
        readers: Mapping[str, Sequence[int]],
        ends_run: Sequence[int],
        observe: Observer,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.now_ns = 0
        self.exit_code: int | None = None
        self.activation_count = 0
        self._nodes = nodes
        self.rewire(readers)
        self._ends_run = set(ends_run)
        self._observe = observe
        self._check = check
        self._due: dict[int, int] = {}
        self._finished: set[int] = set()
        self._end_ns: int | None = None

    def activate(self) -> None:
        """Activate every node in graph order at time 0 and run the rounds that this causes."""
        published: list[bytes] = []
        for index in range(len(self._nodes.names)):
            published += self._account(index, self._nodes.activate(index))
        self._run_rounds(published)

    def rewire(self, readers: Mapping[str, Sequence[int]]) -> None:
        self._readers = {topic.encode(): tuple(indices) for topic, indices in readers.items()}

    def accept(self, index: int, done: Done) -> None:
        """Take what a node has published between two instants, and run the rounds that this causes."""
        self._run_rounds(self._account(index, done))

    def run(self, until_ns: int | None = None) -> int:
        """Go on until a node whose end is the run's end has finished, or until a time; return the exit code.

        A run within a run, as a swap lets time go by, ends with the outer one at the latest.
        """
        outer_ns = self._end_ns
        ends = [end_ns for end_ns in (until_ns, outer_ns) if end_ns is not None]
        self._end_ns = until_ns = min(ends, default=None)
        try:
            return self._run(until_ns)
        finally:
            self._end_ns = outer_ns

    def _run(self, until_ns: int | None) -> int:
        while self.exit_code is None:
            self._check()
            if self.exit_code is not None:  # there was work in between
                break
            due_ns = min(self._due.values(), default=None)
            if due_ns is None:
                raise GraphError(
                    f"at {self.now_ns / 1e9:.3f} s the graph is stuck: "
                    "every node waits for a message and no timer is due"
                )
            if until_ns is not None and due_ns > until_ns:
                self.now_ns = max(self.now_ns, until_ns)
                return 0
            self.now_ns = max(due_ns, self.now_ns)
            self._run_rounds([])
        return self.exit_code

    def shutdown(self, index: int) -> None:
        self._account(index, self._nodes.shutdown(index, self.now_ns))

    def _run_rounds(self, published: list[bytes]) -> None:
        now_ns = self.now_ns
        inbox: dict[int, list[tuple[bytes, int, bytes]]] = {}
        for count in range(MAX_ROUNDS + 1):
            inbox.clear()
            for frame in published:
                topic = topic_of(frame)
                for index in self._readers.get(topic, ()):
                    if index not in self._finished:
                        inbox.setdefault(index, []).append((topic, sequence_of(frame, len(topic)), frame))
            active = {i for i, due_ns in self._due.items() if due_ns <= now_ns}.union(inbox)
            if count == 0:
                active |= self._nodes.pending_commands()
            if not active:
                return
            if count == MAX_ROUNDS:
                break
            rounds = {
                index: Round(now_ns, [frame for _, _, frame in sorted(inbox.get(index, ()))])
                for index in sorted(active)
            }
            replies = self._nodes.work(rounds)
            self.activation_count += len(rounds)
            published = []
            for index in rounds:
                published += self._account(index, replies[index])
        names = ", ".join(sorted({self._nodes.names[index] for index in active}))
        read = {topic_of(frame) for frame in published} & self._readers.keys()
        topics = ", ".join(sorted(str(topic, "utf-8") for topic in read)) or "alarms"
        raise GraphError(
            f"at {now_ns / 1e9:.3f} s the graph did not come to rest within {MAX_ROUNDS} rounds: "
            f"{names} keep answering each other over {topics}; break the cycle with a timer"
        )

    def _account(self, index: int, done: Done) -> list[bytes]:
        if done.next_due_ns >= 0:
            self._due[index] = done.next_due_ns
        else:
            self._due.pop(index, None)
        if done.exit_code is not None:
            self._finished.add(index)
            self._due.pop(index, None)
            if index in self._ends_run and self.exit_code is None:
                self.exit_code = done.exit_code
        for frame in done.frames:
            self._observe(self.now_ns, frame)
        return done.frames
