"""All nodes of a lockstep graph in this process; messages are encoded and decoded all the same."""

import contextlib
import faulthandler
import io
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import in_words
from palp_core.graph.clock import SimClock
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspect_classes
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.log_format import MergedFormatter, time_text
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import COMPOSITION, MERGED_LOG, NodeSpec
from palp_core.graph.process.control_messages import Configured, Done, Failed, Matched, Round
from palp_core.graph.process.lockstep_loop import LockstepNode, SharedRounds
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.process.swap_messages import ToSwapped
from palp_core.graph.process.swap_participant import SharedSockets
from palp_core.graph.supervision.logs import LogFile
from palp_core.graph.supervision.managed_process import ManagedProcess
from palp_core.graph.supervision.standby import Standby
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.whole_file import PRIVATE

_ENCODER, _DECODER = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(ToSwapped)
POLL_ROUNDS = 32  # asking a socket costs as much as a message; tools wait a few ms more


class Composition:
    """The nodes of a lockstep graph in this process.

    With ``keep_orders`` each publishes what it consumes, for a bag that is to be replayed.

    Attributes:
        names: Of the nodes.
        processes: As a swap sees the nodes: all in this process.
        standbys: Makes and reaches the node that takes another's place.
        swap: Who does the rounds of a node of which there are two.
        working: The node that works.
        clock: That of all nodes.
    """

    start_ns = 0
    exit_code: int | None = None

    def __init__(
        self,
        specs: Sequence[NodeSpec],
        workspace: str,
        sockets: NodeSockets | None = None,
        *,
        keep_orders: bool = True,
    ) -> None:
        self.names = [spec.name for spec in specs]
        self.clock = SimClock()
        self.swap: SharedRounds | None = None
        self.standbys = self
        self.processes = [ManagedProcess(spec, Path()) for spec in specs]
        self._workspace, self._sockets, self._keep_orders = workspace, sockets, keep_orders
        self._round_count = 0
        self._standby_node: LockstepNode | None = None
        self.working = COMPOSITION
        self._nodes = [
            LockstepNode(
                spec, workspace, self.clock, SharedSockets(sockets), self.processes[index].replies.append
            )
            for index, spec in enumerate(specs)
        ]
        for process, node in zip(self.processes, self._nodes, strict=True):
            process.matched = True
            node.executor.journal.kept = keep_orders
            node.executor.transition(Transition.CONFIGURE)
            self._offer(node.executor)

    def _offer(self, executor: Executor) -> None:
        if self._sockets is not None:
            self._sockets.publisher.offer(executor.ends.publishers.values())
            self._sockets.requests.add(executor.name, NodeServices(executor).operations(), CHANGING)

    def activate(self, index: int) -> Done:
        return self._nodes[index].transition(Transition.ACTIVATE)

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        self._round_count += 1
        sockets, swap = self._sockets, self.swap
        if sockets is not None and self._round_count % POLL_ROUNDS == 0:
            sockets.poll()
        replies = {}
        for index, message in rounds.items():
            self.working = self.names[index]
            self.clock.set(message.now_ns)
            if sockets is not None and sockets.requests.waiting and not self._holds_requests(index):
                sockets.requests.run_deferred(self.names[index])
            shared = swap is not None and swap.index == index
            replies[index] = swap.work(message) if shared and swap else self._nodes[index].work(message)
        return replies

    def work_together(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let nodes work, though another is in standby."""
        return {index: self._nodes[index].work(message) for index, message in rounds.items()}

    def pending_commands(self) -> set[int]:
        waiting = self._sockets.requests.waiting if self._sockets is not None else ()
        indices = {self.names.index(name) for name in waiting}
        return {index for index in indices if not self._holds_requests(index)}

    def _holds_requests(self, index: int) -> bool:
        return self.swap is not None and self.swap.index == index and self.swap.holds_requests

    def shutdown(self, index: int, now_ns: int) -> Done:
        self.clock.set(now_ns)
        return self._nodes[index].transition(Transition.SHUTDOWN)

    # Swap

    def inspect_class(self, request: NodeClassRequest, workspace: Path, _: float) -> NodeClass:
        """Return what a class declares; this process has imported the workspace anyway."""
        return inspect_classes([request], workspace)[0]

    def start(self, spec: NodeSpec, log: Path, *, fresh: bool) -> Standby:
        """Configure a node next to the one that has its part."""
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
            self._standby_node.executor.journal.kept = self._keep_orders
            self._standby_node.executor.transition(Transition.CONFIGURE)
            standby.receive(Configured())
            standby.receive(Matched())
        return standby

    def send(self, standby: Standby, message: ToSwapped | Round) -> None:
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
            self._standby_node.executor.leave()
        standby.process.ended = True
        self._standby_node = None

    def retire(self, index: int, former: Standby) -> None:
        """Forget the node that has left; it was where the new one is."""
        del index, former
        self._standby_node = None


@contextlib.contextmanager
def _failing(standby: Standby) -> Iterator[None]:
    """Note what a node fails of, as its process would report it."""
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
    checked: CheckedGraph,
    directory: RunDirectory,
    log_level: str = "info",
    *,
    capture: bool = False,
    keep_orders: bool = True,
) -> Iterator[Composition]:
    """Compose a graph; tools find it in its run directory, and there is the log of all its nodes.

    With ``capture`` what nodes print goes there, too; the launcher itself writes to the attribute
    ``launcher_stream`` of standard output and error.
    """
    log = LogFile(directory.log(MERGED_LOG))
    output = NodeOutput(log)
    with contextlib.ExitStack() as stack:
        stack.callback(log.close)
        stack.enter_context(_logging_to(log, log_level, output, capture=capture))
        sockets = NodeSockets(*endpoints(str(directory.path), COMPOSITION))
        stack.callback(sockets.close)
        if capture:
            stack.enter_context(_captured(output, log, directory.log(COMPOSITION)))
        composition = Composition(checked.nodes, checked.workspace, sockets, keep_orders=keep_orders)
        output.working = lambda: composition.working
        yield composition


@contextlib.contextmanager
def _logging_to(log: LogFile, level: str, output: "NodeOutput", *, capture: bool) -> Iterator[None]:
    """Let what nodes log go to the log; with ``capture`` what Python warns of, too, as one of theirs."""
    handler = logging.StreamHandler(NodeOutput(log, head=False))
    handler.setFormatter(_ComposedFormatter(output))
    loggers = [logging.getLogger(name) for name in (("palp", "py.warnings") if capture else ("palp",))]
    before = loggers[0].level
    loggers[0].setLevel(level.upper())
    for logger in loggers:
        logger.addHandler(handler)
    logging.captureWarnings(capture)
    try:
        yield
    finally:
        logging.captureWarnings(False)
        for logger in loggers:
            logger.removeHandler(handler)
        loggers[0].setLevel(before)


class _ComposedFormatter(MergedFormatter):
    """A warning of Python is one of the node that works."""

    def __init__(self, output: "NodeOutput") -> None:
        super().__init__()
        self._output = output

    def node_of(self, record: logging.LogRecord) -> str:
        return self._output.working() if record.name == "py.warnings" else super().node_of(record)


class NodeOutput(io.TextIOBase):
    """Standard output of composed nodes: each line goes to the log, as one of the node that works.

    Attributes:
        launcher_stream: Where the launcher writes meanwhile.
        working: Returns which node works.
    """

    def __init__(self, log: LogFile, *, head: bool = True) -> None:
        self.launcher_stream: Any = None
        self.working: Callable[[], str] = lambda: COMPOSITION
        self._log, self._head, self._rest = log, head, ""

    def write(self, text: str) -> int:
        *lines, self._rest = (self._rest + text).split("\n")
        head = f"{time_text()} {self.working()}: " if self._head and lines else ""
        self._log.write("".join(f"{head}{line}\n" for line in lines).encode(errors="backslashreplace"))
        return len(text)

    def end_line(self) -> None:
        if self._rest:
            self.write("\n")

    def fileno(self) -> int:
        """Return what a process that a node starts writes to."""
        return 1


@contextlib.contextmanager
def _captured(output: NodeOutput, log: LogFile, below: Path) -> Iterator[None]:
    """Let what nodes print go to the log, and what is written below Python into a file of its own."""
    real = sys.stdout, sys.stderr
    error = NodeOutput(log)
    error.working = lambda: output.working()
    saved: list[int] = []
    streams: list[Any] = list(real)
    if all(_number(stream) == number for number, stream in enumerate(real, 1)):
        file = os.open(below, os.O_WRONLY | os.O_CREAT | os.O_APPEND, PRIVATE)
        for number, stream in enumerate(real, 1):
            stream.flush()
            saved.append(os.dup(number))
            os.dup2(file, number)
            streams[number - 1] = open(  # noqa: SIM115 - closed below
                saved[-1], "w", encoding=stream.encoding, errors=stream.errors, closefd=False
            )
        os.close(file)
    output.launcher_stream, error.launcher_stream = streams
    sys.stdout, sys.stderr = output, error
    if saved and faulthandler.is_enabled():
        faulthandler.enable(saved[1])
    try:
        yield
    finally:
        sys.stdout, sys.stderr = real
        output.end_line()
        error.end_line()
        for number, descriptor in enumerate(saved, 1):
            streams[number - 1].flush()
            os.dup2(descriptor, number)
        if saved and faulthandler.is_enabled():
            faulthandler.enable(2)
        for descriptor in saved:
            os.close(descriptor)


def _number(stream: Any) -> int:
    try:
        return int(stream.fileno())
    except (OSError, ValueError, AttributeError):
        return -1
