"""Drive nodes again from a bag and compare what they publish with what was recorded, byte by byte.

Each node wrote down what it consumed, in order: activation, timers, messages, changes of parameters. A fresh
node is driven through exactly that on a clock that shows what it showed then, as fast as the machine allows.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.bag.reader import Bag, RecordedMessage
from palp_core.errors import BagError
from palp_core.runtime.birth import load_class
from palp_core.runtime.builtin import Order
from palp_core.runtime.clock import SimClock, monotonic_ns
from palp_core.runtime.commands import read_request, serve_outside, set_parameters
from palp_core.runtime.executor import Executor
from palp_core.runtime.lifecycle import Transition
from palp_core.runtime.message import decode, decode_any
from palp_core.runtime.order import ORDER_PORT, OUTSIDE, PARAMETERS, TRANSITIONS
from palp_core.runtime.spec import NodeSpec, topic
from palp_core.runtime.wire import Kind, pack, parse

__all__ = ["NODES_ATTACHMENT", "Divergence", "NodeReplay", "replay"]

NODES_ATTACHMENT = "palp/nodes.json"


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The first output that differs, and the last thing the node had consumed before it."""

    topic: str
    sequence: int
    now_s: float
    what: str
    after: str


class NodeReplay(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one node.

    Attributes:
        consumed: Entries of its written order.
        compared: Outputs that were equal.
        clock_s: Time on the graph's clock that was replayed.
        wall_s: Time that it took.
        divergence: The first difference; None if there is none.
    """

    node: str
    consumed: int
    compared: int
    clock_s: float
    wall_s: float
    divergence: Divergence | None


def replay(path: str | Path, nodes: Sequence[str], workspace: str | Path) -> list[NodeReplay]:
    """Replay named nodes of a recorded run, each from the bag alone.

    Args:
        path: The bag.
        nodes: Running names.
        workspace: Folder that holds ``nodes/``.

    Raises:
        BagError: The bag was not recorded with its graph, has no such node, lacks a message that the node
            consumed, or the node writes files or moves a device.
        NodeError: The node fails where it did not.
    """
    with Bag(path) as bag:
        attached = bag.attachments().get(NODES_ATTACHMENT)
        if attached is None:
            raise BagError(f"{path}: no {NODES_ATTACHMENT} in it; record with palp launch FILE --record DIR")
        specs = {spec.name: spec for spec in msgspec.json.decode(attached, type=list[NodeSpec])}
        for name in nodes:
            if name not in specs:
                raise BagError(f"{path}: no node '{name}' in it; there are: {', '.join(specs)}")
        return [_Replay(bag, specs[name], str(workspace)).run() for name in nodes]


class _Replay:
    """One node driven from its written order."""

    def __init__(self, bag: Bag, spec: NodeSpec, workspace: str) -> None:
        node_class = load_class(spec.run, workspace)
        if node_class.records:
            raise BagError(f"node '{spec.name}' keeps a record on disk; replaying it would write it again")
        if node_class.moves and spec.params.get("device", "sim") != "sim":
            raise BagError(f"node '{spec.name}' moves a device; only simulated ones are replayed")
        self._bag, self._spec = bag, spec
        self._clock = SimClock()
        self._frames: list[bytes] = []
        self._executor = Executor(node_class, spec, self._clock, self._frames.append)
        self._topic_of = self._executor.ends.topic_of_source
        self._inputs: dict[str, Iterator[RecordedMessage]] = {}
        self._outputs: dict[str, Iterator[RecordedMessage]] = {}
        self._last_input: tuple[str, int, int] | None = None
        self._after = "nothing"
        self._compared = 0

    def run(self) -> NodeReplay:
        """Drive the node to the end of its order, or to the first difference."""
        begin_ns = monotonic_ns()
        consumed, first_ns = 0, -1
        divergence = None
        self._executor.transition(Transition.CONFIGURE)
        for order in self._orders():
            for entry in range(len(order.source)):
                now_ns = order.now_ns[entry]
                first_ns = now_ns if first_ns < 0 else first_ns
                self._clock.set(now_ns)
                self._consume(order, entry)
                consumed += 1
                divergence = self._difference()
                if divergence is not None:
                    break
            if divergence is not None:
                break
        if divergence is None:
            self._executor.transition(Transition.SHUTDOWN)
            divergence = self._difference() or self._missing()
        return NodeReplay(
            node=self._spec.name,
            consumed=consumed,
            compared=self._compared,
            clock_s=(self._clock.now_ns() - max(first_ns, 0)) / 1e9,
            wall_s=(monotonic_ns() - begin_ns) / 1e9,
            divergence=divergence,
        )

    def _orders(self) -> Iterator[Order]:
        for message in self._bag.recorded([topic(self._spec.name, ORDER_PORT)]):
            yield decode(Order, message.payload)

    def _consume(self, order: Order, entry: int) -> None:
        source, sequence = order.sources[order.source[entry]], order.sequence[entry]
        self._after = f"{source} {sequence} at {order.now_ns[entry] / 1e9:.6f} s"
        executor = self._executor
        if source in TRANSITIONS:
            executor.transition(Transition(source))
        elif source == PARAMETERS:
            set_parameters(executor, json.loads(order.changes[sequence]))
        elif source.startswith(OUTSIDE):
            service = source.removeprefix(OUTSIDE)
            written = json.loads(order.changes[sequence])["request"]
            serve_outside(executor, service, read_request(executor, service, written))
        elif source.startswith("timer:"):
            executor.ring(source.removeprefix("timer:"), sequence)
        else:
            name = self._topic_of[source]
            this = (name, order.epoch[entry], sequence)
            if this != self._last_input:  # one topic may feed two inputs: both are served at once
                self._last_input = this
                self._executor.consume(self._recorded_frame(*this))

    def _recorded_frame(self, name: str, epoch: int, sequence: int) -> bytes:
        messages = self._inputs.setdefault(name, self._bag.recorded([name]))
        for message in messages:
            if (message.stream.epoch, message.sequence) == (epoch, sequence):
                type_hash = int(message.stream.topic.type_hash, 16)
                return pack(
                    name.encode(), Kind.DATA, epoch, sequence, message.publish_ns, type_hash, message.payload
                )
        raise BagError(f"{self._spec.name} consumed {name} {sequence} (epoch {epoch}); it is not in the bag")

    def _difference(self) -> Divergence | None:
        """Compare what the node has just published with the recording."""
        frames, self._frames[:] = self._frames[:], []
        for frame in map(parse, frames):
            if frame.topic == topic(self._spec.name, ORDER_PORT):
                continue
            recorded = next(self._outputs.setdefault(frame.topic, self._bag.recorded([frame.topic])), None)
            if recorded is None:
                return self._diverged(frame.topic, frame.sequence, "replayed, but not recorded")
            if (recorded.sequence, recorded.publish_ns) != (frame.sequence, frame.stamp_ns):
                was = f"recorded as {recorded.sequence} at {recorded.publish_ns} ns"
                return self._diverged(
                    frame.topic, frame.sequence, f"{was}, replayed as {frame.sequence} at {frame.stamp_ns} ns"
                )
            if recorded.payload != bytes(frame.payload):
                return self._diverged(
                    frame.topic, frame.sequence, _fields(recorded.payload, bytes(frame.payload))
                )
            self._compared += 1
        return None

    def _missing(self) -> Divergence | None:
        """Return the first output that was recorded and not replayed."""
        taken_in = {ORDER_PORT, *self._spec.external}
        for name in self._executor.outlets:
            if name not in {topic(self._spec.name, port) for port in taken_in}:
                left = next(self._outputs.setdefault(name, self._bag.recorded([name])), None)
                if left is not None:
                    return self._diverged(name, left.sequence, "recorded, but not replayed")
        return None

    def _diverged(self, name: str, sequence: int, what: str) -> Divergence:
        return Divergence(
            topic=name,
            sequence=sequence,
            now_s=self._clock.now_ns() / 1e9,
            what=what,
            after=self._after,
        )


def _fields(recorded: bytes, replayed: bytes) -> str:
    """Say which fields of a message differ."""
    before, now = decode_any(dict[str, Any], recorded), decode_any(dict[str, Any], replayed)
    names = [name for name in before.keys() | now.keys() if before.get(name) != now.get(name)]
    return "; ".join(
        f"{name}: recorded {_shown(before.get(name))}, replayed {_shown(now.get(name))}"
        for name in sorted(names)
    )


def _shown(value: object) -> object:
    return f"<{len(value)} bytes>" if isinstance(value, bytes) else value
