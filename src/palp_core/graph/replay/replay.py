"""Drive nodes again from a bag and compare what they publish with what was recorded, byte by byte.

Each node wrote down what it consumed, in order: activation, timers, messages, changes of parameters. A fresh
node is driven through exactly that on a clock that shows what it showed then, as fast as the machine allows.
"""

import contextlib
import json
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError, NodeError
from palp_core.graph.bag.diff import first_difference
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.rounds import NODES_ATTACHMENT
from palp_core.graph.bag.stream import decoder_for
from palp_core.graph.clock import SimClock, monotonic_ns
from palp_core.graph.messages.builtin import MethodsUsed, Order
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.message import decode, decode_any, encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.journal import ORDER_PORT, OUTSIDE, PARAMETERS, TRANSITIONS
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import load_class
from palp_core.graph.node.node import class_name
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.replay.streams import Key, OrderedMessages, RecordedInputs, key_of

RECENT = 5
Close = Callable[[float, float], bool]


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The first output that differs, and what the node had consumed before it: last, and the last few."""

    topic: str
    sequence: int
    now_s: float
    what: str
    after: str
    inputs: list[str] = []


class NodeReplay(msgspec.Struct, frozen=True, kw_only=True):
    node: str
    consumed: int  # entries of its written order
    compared: int  # outputs that were equal
    # Outputs in the bag before the place where the replay could begin, or after the last of the written
    # order: a node or a recorder that was killed takes the latest tenth of a second with it.
    uncovered: int = 0
    clock_s: float  # time on the graph's clock that was replayed
    wall_s: float  # time that it took
    divergence: Divergence | None


def replay(
    path: str | Path, nodes: Sequence[str], workspace: str | Path, close: Close | None = None
) -> list[NodeReplay]:
    """Replay named nodes of a recorded run, each from the bag alone; its class is in the workspace.

    ``close`` returns whether two numbers count as equal (another kind of processor rounds otherwise);
    without it outputs are to have the recorded bytes.
    """
    with Bag(path) as bag:
        attached = bag.attachments().get(NODES_ATTACHMENT)
        if attached is None:
            raise BagError(
                f"{path}: no {NODES_ATTACHMENT} in it; "
                "record with palp launch FILE --record DIR, or palp bag record -a"
            )
        specs = {spec.name: spec for spec in msgspec.json.decode(attached, type=list[NodeSpec])}
        for name in nodes:
            if name not in specs:
                raise BagError(f"{path}: no node '{name}' in it; there are: {', '.join(specs)}")
        return [_Replay(bag, specs[name], str(workspace), close).run() for name in nodes]


class _Replay:
    """One node driven from its written order.

    It begins where the node became active; in a recording that began later, where the node's state was
    written down; and again after a restart, a swap or a hole in the written order.
    """

    def __init__(self, bag: Bag, spec: NodeSpec, workspace: str, close: Close | None) -> None:
        self._bag, self._spec, self._workspace, self._close = bag, spec, workspace, close
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        self._clock = SimClock()
        self._frames: list[bytes] = []
        self._executor: Executor | None = None
        self._hand_over: HandOver | None = None
        self._order_topic = topic(spec.name, ORDER_PORT)
        self._inputs = RecordedInputs(bag)
        self._outputs: dict[str, OrderedMessages] = {}
        self._waiting: dict[str, RecordedMessage | None] = {}
        self._synced: set[str] = set()
        self._last_input: tuple[str, int, int] | None = None
        self._recent: deque[str] = deque(maxlen=RECENT)
        self._compared = self._uncovered = self._consumed = 0
        self._first_ns: int | None = None
        self._whole = SUMMARY_NAME in bag.attachments()
        self._cut = False

    def run(self) -> NodeReplay:
        """Drive the node to the end of its order, or to the first difference."""
        begin_ns = monotonic_ns()
        divergence, end = self._drive()
        if self._executor is None:
            raise BagError(
                f"{self._bag.path}: it is not recorded what node '{self._spec.name}' consumed "
                f"({self._order_topic}): record all topics, palp bag record -a"
            )
        if divergence is None:
            divergence = self._first_missing(end)
            with contextlib.suppress(NodeError):
                self._executor.transition(Transition.SHUTDOWN)
        return NodeReplay(
            node=self._spec.name,
            consumed=self._consumed,
            compared=self._compared,
            uncovered=self._uncovered,
            clock_s=(self._clock.now_ns() - (self._first_ns or 0)) / 1e9,
            wall_s=(monotonic_ns() - begin_ns) / 1e9,
            divergence=divergence,
        )

    def _drive(self) -> tuple[Divergence | None, tuple[int, int]]:
        """Consume the order; return the first difference, and the epoch and time that the order reaches."""
        place, end = (-1, 0), (-1, 0)
        for message in OrderedMessages(self._bag, self._order_topic):
            order = decode(Order, message.payload)
            follows = key_of(message) == (place[0], place[1] + 1)
            if not self._prepare_node(order, key_of(message), follows=follows and self._executor is not None):
                continue
            assert self._executor is not None
            place, end = key_of(message), (message.stream.epoch, order.stamp_ns)
            for entry in range(len(order.source)):
                now_ns = order.now_ns[entry]
                self._first_ns = now_ns if self._first_ns is None else self._first_ns
                self._clock.set(now_ns)
                try:
                    self._consume(order, entry)
                except NodeError:
                    if entry + 1 < len(order.source):
                        raise
                    self._executor.finish(1)  # it failed then, too: nothing follows but its next process
                self._consumed += 1
                divergence = self._first_difference()
                if divergence is not None or self._cut:
                    return divergence, end
        return None, end

    def _prepare_node(self, order: Order, key: Key, *, follows: bool) -> bool:
        """Have a node for a batch of the order; return False if it does not show where to begin."""
        hand_over = decode_any(HandOver, order.hand_over) if order.hand_over else None
        if follows and (hand_over is None or not self._was_replaced(hand_over)):
            return True
        epoch, sequence = key
        first = bool(order.source) and order.sources[order.source[0]]
        begins = sequence == 1 and first == Transition.ACTIVATE  # a later one has a state from before
        if hand_over is None and not begins:
            return False
        spec = msgspec.structs.replace(self._spec, epoch=epoch)
        if hand_over is not None:
            spec = msgspec.structs.replace(spec, params=hand_over.params)
            run = self._spec.run if self._has_class(hand_over.node_class) else hand_over.node_class
            spec = msgspec.structs.replace(spec, run=run)
        self._executor = executor = _executor(spec, self._workspace, self._clock, self._frames)
        if hand_over is not None:
            executor.take_over(hand_over)
            executor.ends.resume(hand_over)  # what it published as it took over was published before
        self._frames.clear()
        self._synced.clear()
        self._hand_over = hand_over
        return True

    def _has_class(self, name: str) -> bool:
        return class_name(load_class(self._spec.run, self._workspace)) == name

    def _was_replaced(self, hand_over: HandOver) -> bool:
        """Return whether another class, or this one with other parameters, runs since the last batch."""
        assert self._executor is not None
        node = self._executor.node
        if class_name(type(node)) != hand_over.node_class:
            return True
        return encode_any(msgspec.to_builtins(node.params)) != encode_any(hand_over.params)

    def _consume(self, order: Order, entry: int) -> None:
        executor = self._executor
        assert executor is not None
        source, sequence = order.sources[order.source[entry]], order.sequence[entry]
        self._recent.append(f"{source} {sequence} at {order.now_ns[entry] / 1e9:.6f} s")
        if source in TRANSITIONS or source == Transition.SHUTDOWN:
            executor.transition(Transition(source))
        elif source == PARAMETERS:
            executor.set_parameters(json.loads(order.changes[sequence]))
        elif source.startswith(OUTSIDE):
            service = source.removeprefix(OUTSIDE)
            written = json.loads(order.changes[sequence])["request"]
            executor.call_service(service, executor.recorded_request(service, written))
        elif source.startswith("timer:"):
            executor.run_timer(source.removeprefix("timer:"), sequence)
        else:
            name = executor.ends.topic_of_source[source]
            this = (name, order.epoch[entry], sequence)
            if this != self._last_input:  # one topic may feed two inputs: both are served at once
                self._last_input = this
                frame = self._recorded_frame(*this)
                if frame is not None:
                    executor.consume(frame)

    def _recorded_frame(self, name: str, epoch: int, sequence: int) -> Frame | None:
        """Return a message that the node consumed; None at the end of a bag whose recorder was killed."""
        message = self._inputs.find(name, epoch, sequence)
        self._cut = message is None and not self._whole
        if self._cut:
            return None
        if message is None:
            raise BagError(
                f"{self._spec.name} consumed {name} {sequence} (epoch {epoch}); it is not in the bag"
            )
        type_hash = int(message.stream.topic.type_hash, 16)
        return Frame(name, Kind.DATA, epoch, sequence, message.publish_ns, type_hash, message.payload)

    @property
    def _commentary(self) -> set[str]:
        """Topics that are not compared: the order itself, and what the register has of methods today."""
        assert self._executor is not None
        outputs = self._executor.ends.publishers.items()
        return {name for name, out in outputs if out.message in (Order, MethodsUsed)}

    def _first_difference(self) -> Divergence | None:
        """Compare what the node has just published with the recording."""
        frames, self._frames[:] = self._frames[:], []
        for frame in map(parse, frames):
            if frame.topic in self._commentary:
                continue
            recorded = self._next_output(frame.topic, (frame.epoch, frame.sequence))
            if recorded is None and not self._whole:
                self._cut = True
                return None
            if recorded is None:
                return self._divergence(frame.topic, frame.sequence, "replayed, but not recorded")
            if (recorded.sequence, recorded.publish_ns) != (frame.sequence, frame.stamp_ns):
                was = f"recorded as {recorded.sequence} at {recorded.publish_ns} ns"
                return self._divergence(
                    frame.topic, frame.sequence, f"{was}, replayed as {frame.sequence} at {frame.stamp_ns} ns"
                )
            if not self._same(recorded, bytes(frame.payload)):
                return self._divergence(
                    frame.topic, frame.sequence, _differing_fields(recorded.payload, bytes(frame.payload))
                )
            self._waiting[frame.topic] = None
            self._compared += 1
        return None

    def _same(self, recorded: RecordedMessage, payload: bytes) -> bool:
        if recorded.payload == payload or self._close is None:
            return recorded.payload == payload
        name = recorded.stream.topic.name
        known = self._decoders[name] = self._decoders.get(name) or decoder_for(recorded.stream)
        return first_difference(known(recorded.payload), known(payload), self._close) is None

    def _next_output(self, name: str, key: tuple[int, int]) -> RecordedMessage | None:
        """Return the recorded output that is due; what is before the place of beginning is not compared."""
        messages = self._outputs.setdefault(name, OrderedMessages(self._bag, name))
        message = self._waiting.get(name) or next(messages, None)
        while message is not None and name not in self._synced and key_of(message) < key:
            self._uncovered += 1
            message = next(messages, None)
        self._synced.add(name)
        self._waiting[name] = message
        return message

    def _first_missing(self, end: tuple[int, int]) -> Divergence | None:
        """Return the first output that was recorded and not replayed, as far as the order reaches."""
        assert self._executor is not None
        taken_in = {topic(self._spec.name, port) for port in self._spec.external}
        for name, publisher in self._executor.ends.publishers.items():
            if name in taken_in or name in self._commentary:
                continue
            left = self._next_output(name, (publisher.epoch, publisher.sequence + 1))
            if left is not None and (left.stream.epoch, left.publish_ns) <= end:
                return self._divergence(name, left.sequence, "recorded, but not replayed")
            rest = self._outputs[name]
            self._uncovered += (left is not None) + sum(1 for _ in rest)
        return None

    def _divergence(self, name: str, sequence: int, what: str) -> Divergence:
        return Divergence(
            topic=name,
            sequence=sequence,
            now_s=self._clock.now_ns() / 1e9,
            what=what,
            after=self._recent[-1] if self._recent else "nothing",
            inputs=list(self._recent),
        )


def _executor(spec: NodeSpec, workspace: str, clock: SimClock, frames: list[bytes]) -> Executor:
    """Return a configured node that can be driven without harm."""
    node_class = load_class(spec.run, workspace)
    if node_class.records:
        raise BagError(f"node '{spec.name}' keeps a record on disk; replaying it would write it again")
    if node_class.moves and spec.params.get("device", "sim") != "sim":
        raise BagError(f"node '{spec.name}' moves a device; only simulated ones are replayed")
    executor = Executor(node_class, spec, clock, frames.append)
    executor.transition(Transition.CONFIGURE)
    return executor


def _differing_fields(recorded: bytes, replayed: bytes) -> str:
    before, now = decode_any(dict[str, Any], recorded), decode_any(dict[str, Any], replayed)
    names = [name for name in before.keys() | now.keys() if before.get(name) != now.get(name)]
    return "; ".join(
        f"{name}: recorded {_shown(before.get(name))}, replayed {_shown(now.get(name))}"
        for name in sorted(names)
    )


def _shown(value: object) -> object:
    return f"<{counted(len(value), 'byte')}>" if isinstance(value, bytes) else value
