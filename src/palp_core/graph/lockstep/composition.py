"""All nodes of a lockstep graph in this process; messages are encoded and decoded all the same."""

import contextlib
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from palp_core.graph.clock import SimClock
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.log_format import MergedFormatter
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints, load_class, shared_process
from palp_core.graph.node.spec import COMPOSITION, MERGED_LOG, NodeSpec
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.process.lockstep_loop import follow_round
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.process.probation import LockstepProbation
from palp_core.graph.process.shadow import ShadowComparison
from palp_core.graph.transport.node_sockets import NodeSockets

POLL_ROUNDS = 32  # asking a socket costs as much as a message; tools wait a few ms more


class Composition:
    """The nodes of a lockstep graph in this process.

    Attributes:
        shadow: The number of a node, who works beside it unheard, what that publishes, how they compare.
        probation: The rounds of a node whose predecessor stands by.
    """

    def __init__(self, specs: Sequence[NodeSpec], workspace: str, sockets: NodeSockets | None = None) -> None:
        self.names = [spec.name for spec in specs]
        self.clock = SimClock()
        self._workspace = workspace
        self._frames: list[bytes] = []
        self.shadow: tuple[int, Executor, list[bytes], ShadowComparison] | None = None
        self.probation: LockstepProbation | None = None
        self._unheard = False
        self._sockets = sockets
        self._round_count = 0
        self._executors = [
            Executor(load_class(spec.run, workspace), spec, self.clock, self._send) for spec in specs
        ]
        for executor in self._executors:
            executor.transition(Transition.CONFIGURE)
            self._offer(executor)

    def _offer(self, executor: Executor) -> None:
        if self._sockets is not None:
            self._sockets.publisher.offer(executor.ends.publishers.values())
            self._sockets.requests.add(executor.name, NodeServices(executor).operations(), CHANGING)

    def _send(self, frame: bytes) -> None:
        self._frames.append(frame)
        if not self._unheard:
            self._tell(frame)

    def _tell(self, frame: bytes) -> None:
        if self._sockets is not None and self._sockets.publisher.has_subscribers:
            self._sockets.publisher.send(frame)

    def _done(self, executor: Executor) -> Done:
        frames, self._frames = self._frames, []
        due_ns = executor.next_due_ns()
        return Done(frames, -1 if due_ns is None else due_ns, executor.exit_code)

    def activate(self, index: int) -> Done:
        self._executors[index].transition(Transition.ACTIVATE)
        return self._done(self._executors[index])

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, one after the other."""
        self._round_count += 1
        if self._sockets is not None and self._round_count % POLL_ROUNDS == 0:
            self._sockets.poll()
        replies = {}
        for index, message in rounds.items():
            self.clock.set(message.now_ns)
            if self._sockets is not None and self._sockets.requests.waiting and not self._on_probation(index):
                self._sockets.requests.perform(self.names[index])
            if self.probation is not None and self.probation.index == index:
                replies[index] = self.probation.work(message)
                continue
            replies[index] = self.work_alone(index, message)
            if self.shadow is not None and self.shadow[0] == index:
                self._work_shadow(message, replies[index])
        return replies

    def work_alone(self, index: int, message: Round) -> Done:
        """Let one node do its part of a round."""
        follow_round(self._executors[index], self.clock, message)
        return self._done(self._executors[index])

    def pending_commands(self) -> set[int]:
        """Return the nodes for which a command from outside waits."""
        waiting = self._sockets.requests.waiting if self._sockets is not None else ()
        indices = {self.names.index(name) for name in waiting}
        return {index for index in indices if not self._on_probation(index)}

    def _on_probation(self, index: int) -> bool:
        """Return whether it is not clear yet who goes on as a node: what tools ask of it waits."""
        return self.probation is not None and self.probation.index == index and not self.probation.over

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and end it."""
        self.clock.set(now_ns)
        self._executors[index].transition(Transition.SHUTDOWN)
        return self._done(self._executors[index])

    # Swap

    def _work_shadow(self, message: Round, done: Done) -> None:
        """Let a node's standby do the same as the node, and compare."""
        assert self.shadow is not None
        _, executor, sent, comparison = self.shadow
        follow_round(executor, self.clock, message)
        for frame in done.frames:
            comparison.old(frame)
        for frame in sent:
            comparison.new(frame)
        sent.clear()

    def work_unread(self, index: int, work: Callable[[], None]) -> Done:
        """Let a node work; return what it has published, which :meth:`publish` lets tools hear."""
        self._unheard = True
        try:
            work()
        finally:
            done, self._unheard = self._done(self._executors[index]), False
        return done

    def publish(self, frames: Iterable[bytes]) -> None:
        """Let tools hear what a node has published unheard."""
        for frame in frames:
            self._tell(frame)

    def executor(self, index: int) -> Executor:
        return self._executors[index]

    def start_standby(self, spec: NodeSpec) -> tuple[Executor, list[bytes]]:
        """Configure a node beside the one that has its part; return it and where its frames go meanwhile."""
        held: list[bytes] = []
        node_class = load_class(spec.run, self._workspace, fresh=True)
        executor = Executor(node_class, spec, self.clock, held.append)
        executor.transition(Transition.CONFIGURE)
        return executor, held

    def hand_over(self, index: int) -> tuple[list[bytes], HandOver]:
        """Pause a node; return what it has published on the occasion, and its hand-over."""
        self._executors[index].pause()
        hand_over = self._executors[index].hand_over()
        return self._done(self._executors[index]).frames, hand_over

    def promote(self, index: int, executor: Executor, frames: Iterable[bytes] = ()) -> Done:
        """Give a standby the node's part, and publish what it and the other have to say."""
        self._executors[index] = executor
        self._offer(executor)
        for out in executor.ends.publishers.values():
            out.send = self._send
        self._frames = []
        for frame in frames:
            self._send(frame)
        return self._done(executor)


@contextlib.contextmanager
def composed(
    checked: CheckedGraph, directory: RunDirectory, log_level: str = "info"
) -> Iterator[Composition]:
    """Compose a graph; tools find it in its run directory, and there is the log of all its nodes."""
    handler = logging.FileHandler(directory.log(MERGED_LOG))
    handler.setFormatter(MergedFormatter())
    logger = logging.getLogger("palp")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(log_level.upper())
    sockets = NodeSockets(*endpoints(str(directory.path), COMPOSITION))
    try:
        with shared_process():
            yield Composition(checked.nodes, checked.workspace, sockets)
    finally:
        sockets.close()
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()
