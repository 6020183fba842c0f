"""All nodes of a lockstep graph in this process; messages are encoded and decoded all the same."""

import contextlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from palp_core.errors import in_words
from palp_core.graph.clock import SimClock
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspect_classes
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.log_format import MergedFormatter
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints, shared_process
from palp_core.graph.node.spec import COMPOSITION, MERGED_LOG, NodeSpec
from palp_core.graph.process.control_messages import Configured, Done, Failed, Matched, Round
from palp_core.graph.process.lockstep_loop import LockstepNode, SharedRounds
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.process.swap_messages import ToSwapped
from palp_core.graph.process.swap_participant import SharedSockets
from palp_core.graph.supervision.managed_process import ManagedProcess
from palp_core.graph.supervision.standby import Standby
from palp_core.graph.transport.node_sockets import NodeSockets

_ENCODER, _DECODER = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(ToSwapped)
POLL_ROUNDS = 32  # asking a socket costs as much as a message; tools wait a few ms more


class Composition:
    """The nodes of a lockstep graph in this process.

    Attributes:
        names: Of the nodes.
        processes: As a swap sees the nodes: all in this process.
        standbys: Makes and reaches the node that takes another's place.
        swap: Who does the rounds of a node of which there are two.
        clock: That of all nodes.

    Args:
        specs: The nodes in graph order.
        workspace: Folder that holds ``nodes/``.
        sockets: Where tools listen; None if nobody can.

    Raises:
        GraphError: A class or its parameters do not fit.
        NodeError: A node could not be configured.
    """

    start_ns = 0
    exit_code: int | None = None

    def __init__(self, specs: Sequence[NodeSpec], workspace: str, sockets: NodeSockets | None = None) -> None:
        self.names = [spec.name for spec in specs]
        self.clock = SimClock()
        self.swap: SharedRounds | None = None
        self.standbys = self
        self.processes = [ManagedProcess(spec, Path()) for spec in specs]
        self._workspace, self._sockets = workspace, sockets
        self._round_count = 0
        self._standby_node: LockstepNode | None = None
        self._nodes = [
            LockstepNode(
                spec, workspace, self.clock, SharedSockets(sockets), self.processes[index].replies.append
            )
            for index, spec in enumerate(specs)
        ]
        for process, node in zip(self.processes, self._nodes, strict=True):
            process.matched = True
            node.executor.transition(Transition.CONFIGURE)
            self._offer(node.executor)

    def _offer(self, executor: Executor) -> None:
        if self._sockets is not None:
            self._sockets.publisher.offer(executor.ends.publishers.values())
            self._sockets.requests.add(executor.name, NodeServices(executor).operations(), CHANGING)

    def activate(self, index: int) -> Done:
        """Activate one node."""
        return self._nodes[index].transition(Transition.ACTIVATE)

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, one after the other."""
        self._round_count += 1
        sockets, swap = self._sockets, self.swap
        if sockets is not None and self._round_count % POLL_ROUNDS == 0:
            sockets.poll()
        replies = {}
        for index, message in rounds.items():
            self.clock.set(message.now_ns)
            if sockets is not None and sockets.requests.waiting and not self._holds_requests(index):
                sockets.requests.perform(self.names[index])
            shared = swap is not None and swap.index == index
            replies[index] = swap.work(message) if shared and swap else self._nodes[index].work(message)
        return replies

    def work_together(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let nodes work, whoever stands by."""
        return {index: self._nodes[index].work(message) for index, message in rounds.items()}

    def pending_commands(self) -> set[int]:
        """Return the nodes for which a command from outside waits."""
        waiting = self._sockets.requests.waiting if self._sockets is not None else ()
        indices = {self.names.index(name) for name in waiting}
        return {index for index in indices if not self._holds_requests(index)}

    def _holds_requests(self, index: int) -> bool:
        return self.swap is not None and self.swap.index == index and self.swap.holds_requests

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and end it."""
        self.clock.set(now_ns)
        return self._nodes[index].transition(Transition.SHUTDOWN)

    # Swap

    def inspect_class(self, request: NodeClassRequest, workspace: Path, _: float) -> NodeClass:
        """Return what a class declares; this process has imported the workspace anyway."""
        return inspect_classes([request], workspace)[0]

    def start(self, spec: NodeSpec, log: Path, *, fresh: bool) -> Standby:
        """Configure a node beside the one that has its part."""
        standby = Standby(-1, ManagedProcess(spec, log))
        with _failing(standby):
            self._standby_node = LockstepNode(
                spec,
                self._workspace,
                self.clock,
                SharedSockets(self._sockets),
                standby.receive,
                fresh=fresh,
                successor=True,
            )
            self._standby_node.executor.transition(Transition.CONFIGURE)
            standby.receive(Configured())
            standby.receive(Matched())
        return standby

    def send(self, standby: Standby, message: ToSwapped | Round) -> None:
        """Let the other node do what a swap asks."""
        node = self._standby_node
        assert node is not None
        with _failing(standby):
            if isinstance(message, Round):
                standby.receive(node.work(message))
            else:
                node.change_over(_copied(message))
            if node.participant.left:
                standby.receive(Done([], -1, None))
                standby.process.ended = True

    def send_if_connected(self, index: int, message: ToSwapped) -> None:
        """Let a node do what a swap asks."""
        self._nodes[index].change_over(_copied(message))

    def wait_until(self, condition: Callable[[], bool], deadline_ns: int | None = None) -> bool:
        """Return whether something is so: what is asked is done at once."""
        del deadline_ns
        return condition()

    def promote(self, index: int, standby: Standby) -> None:
        """Let the other node have the part, and the other way round."""
        node = self._standby_node
        assert node is not None
        self._nodes[index], self._standby_node = node, self._nodes[index]
        self.processes[index], standby.process = standby.process, self.processes[index]
        node.answer, self._standby_node.answer = self.processes[index].replies.append, standby.receive
        self._offer(node.executor)

    def kill(self, standby: Standby) -> None:
        """Give up the other node."""
        if not (standby.process.ended or standby.failure) and self._standby_node is not None:
            self._standby_node.executor.succession.leave()
        standby.process.ended = True
        self._standby_node = None

    def retire(self, index: int, former: Standby) -> None:
        """Forget the node that has left; it was where the new one is."""
        del index, former
        self._standby_node = None


@contextlib.contextmanager
def _failing(standby: Standby) -> Iterator[None]:
    """Note what a node fails of, as its process would say it."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # noqa: BLE001 - the class is the user's
        standby.receive(Failed(in_words(error)))


def _copied(message: ToSwapped) -> ToSwapped:
    """Return a message as it is after a journey between two processes."""
    return _DECODER.decode(_ENCODER.encode(message))


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
