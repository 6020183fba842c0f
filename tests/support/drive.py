"""A node in memory, driven frame by frame on a clock that the test moves: what a bench does not show."""

from __future__ import annotations

from typing import Any

from palp_core import Message, Node
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.frame import Kind, pack, parse
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.spec import NodeSpec

MS = 1_000_000


class Drive:
    """An executor with a clock, feeders and the frames it sent; ``resent`` are those sent again."""

    def __init__(self, node_class: type[Node], *, active: bool = True, **spec: Any) -> None:
        self.clock = SimClock()
        self.frames: list[bytes] = []
        self.resent: list[bytes] = []
        self.spec = NodeSpec(**({"name": "n", "run": "m:N"} | spec))
        self.executor = self.configured(node_class)
        if active:
            self.executor.transition(Transition.ACTIVATE)

    def configured(self, node_class: type[Node]) -> Executor:
        """Return an executor of a class on the same clock and wires, configured."""
        made = Executor(node_class, self.spec, self.clock, self.frames.append, resend=self.resent.append)
        made.transition(Transition.CONFIGURE)
        return made

    @property
    def node(self) -> Any:
        return self.executor.node

    def consume(
        self,
        topic: str,
        message: Message,
        sequence: int = 1,
        epoch: int = 0,
        kind: int = Kind.DATA,
        stamp_ns: int | None = None,
    ) -> bytes:
        """Hand the node a message as it comes on a topic; return the frame."""
        stamp = self.clock.now_ns() if stamp_ns is None else stamp_ns
        type_hash = schema_of(type(message)).type_hash
        frame = pack(topic.encode(), kind, epoch, sequence, stamp, type_hash, encode(message))
        self.executor.consume(frame)
        return frame

    def wait(self, duration_ns: int) -> None:
        """Let time go by, with all that is due meanwhile."""
        end_ns = self.clock.now_ns() + duration_ns
        while (due_ns := self.executor.next_due_ns()) is not None and due_ns <= end_ns:
            self.clock.set(max(due_ns, self.clock.now_ns()))
            self.executor.run_timers()
        self.clock.set(end_ns)

    def sent(self, topic: str, message: type[Message]) -> list[Any]:
        """Return the messages that it has published on a topic."""
        return [decode(message, f.payload) for f in map(parse, self.frames) if f.topic == topic]
