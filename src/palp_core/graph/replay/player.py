"""Nodes that publish again what recorded nodes published: the same payload bytes, under the same topics.

In a launch file a :class:`Player` takes the place of a recorded node: it runs under that node's name, its
outputs are that node's topics in the bag, and on either clock it publishes each message when the recorded
node did; in lockstep in the same round. Time counts from the start of the recorded graph, or from the first
message of a bag that was begun later. Its sequences begin at 1.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self

import msgspec
from msgspec import Meta

from palp_core.errors import BagError, GraphError, SchemaMismatch
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.rounds import Rounds
from palp_core.graph.bag.stream import MESSAGE_ENCODING
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_types import message_class
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.node import Node, Params, ReadOnly, State
from palp_core.graph.node.ports import Alarm, Pub, on
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.units import Count, Seconds

Rate = Annotated[float, Meta(ge=1e-3, le=1e3)]
LAUNCHER = "graph"
TOGETHER_NS = 1_000_000_000
"""Players that are activated within this of the graph's start count from the start, all from the same; a bag
that begins within this of its graph's start was begun with it."""
ROUND_GAP_NS = 2_000_000
"""On the wall clock, time between the rounds of one recorded instant: more than a message is on its way to
another process (assumed), so that effects do not overtake causes where each player is a process."""


def playable(bag: Bag) -> dict[str, Topic]:
    """Return the topics of a bag that a node published of its own will; the runtime's own are not among them.

    Orders, events and health are the runtime's, and replies to services belong to who asked.
    """
    foreign = {one.topic.name for one in bag.whole().streams() if one.encoding != MESSAGE_ENCODING}
    found = {}
    for name, topic in bag.topics().items():
        parts = name.split("/")
        if len(parts) == 3 and not parts[0] and parts[1] != LAUNCHER and not parts[2].startswith("_"):
            found[name] = msgspec.structs.replace(topic, json_schema={}) if name in foreign else topic
    return found


def span_ns(bag: Bag) -> tuple[int, int]:
    """Return the log times of a bag's first and last message, in ns; (0, 0) of an empty one."""
    known = [file.statistics for file in bag.files if file.statistics is not None]
    if len(known) == len(bag.files):
        filled = [s for s in known if s.message_count]
        first_ns = min((s.message_start_time for s in filled), default=0)
        return first_ns, max((s.message_end_time for s in filled), default=0)
    first = last = None
    for message in bag.recorded():  # another tool's file may have no statistics
        first = message.log_ns if first is None else min(first, message.log_ns)
        last = message.log_ns if last is None else max(last, message.log_ns)
    return first or 0, last or 0


def begin_ns(bag: Bag, start_offset_s: float) -> int:
    first_ns, _ = span_ns(bag)
    return (first_ns if first_ns > TOGETHER_NS else 0) + round(start_offset_s * 1e9)


def _player_class(base: type[Node], node: str, topics: Mapping[str, Topic]) -> type[Node]:
    """Return the class of a player whose outputs are recorded topics, by port."""
    ports = {port: Pub(recorded_class(topic), qos=_offer(topic)) for port, topic in topics.items()}
    own = sorted(port for port in ports if hasattr(base, port))
    if own:
        raise BagError(f"/{node}/{own[0]} cannot be played: the name is the player's own; remap the topic")
    body = {
        **ports,
        "__module__": base.__module__,
        "__qualname__": base.__qualname__,
        "__doc__": base.__doc__,
    }
    try:
        return type(base.__name__, (base,), body)
    except GraphError as error:
        raise BagError(f"/{node} cannot be played: {error}; leave its topics out") from error


def recorded_class(topic: Topic) -> type[Message]:
    """Return a message class like the one whose messages a topic of a bag has."""
    where = f"{topic.name} cannot be played"
    if "properties" not in topic.json_schema:
        raise BagError(
            f"{where}: its messages are not msgpack, or have no palp schema; convert the bag with "
            "palp bag convert --from ros2 BAG -o NEW, or leave the topic out"
        )
    try:
        made = message_class(topic.json_schema, topic.type)
    except SchemaMismatch as error:
        raise BagError(f"{where}: its schema is not a palp message's: {error}") from error
    if topic.type_hash not in ("", type_hash := schema_of(made).hash_text):
        raise BagError(
            f"{where}: its schema makes a {topic.type} of type hash {type_hash}, recorded was "
            f"{topic.type_hash}: the bag was written by another version or its schema was changed"
        )
    return made


def _outputs(node: str, params: Mapping[str, Any], known: Mapping[str, Topic]) -> dict[str, str]:
    return params.get("topics") or {n.split("/")[2]: n for n in known if n.split("/")[1] == node}


def _offer(topic: Topic) -> Qos:
    if topic.latched_depth:
        return Qos(durability="transient_local", depth=topic.latched_depth)
    return Qos(depth=100)


class PlayerParams(Params):
    """Which bag, and how fast.

    Attributes:
        bag: Its folder or one of its files, from where you are.
        rate: Times the recorded speed.
        start_offset_s: What to leave out from the bag's beginning.
        hold_s: Time on the graph's clock from the last message of the bag to the end of the player's work; 0:
            that ends with the player's own last message.
        topics: Recorded topic of each output; none: those of the node of this name.
    """

    bag: ReadOnly[str]
    rate: ReadOnly[Rate] = 1.0
    start_offset_s: ReadOnly[Seconds] = 0.0
    hold_s: ReadOnly[Seconds] = 0.5
    topics: ReadOnly[dict[str, str]] = {}


class PlayerState(State):
    """How many messages have been published, and when on the graph's clock the bag began; -1: it has not."""

    played_count: Count = 0
    begin_ns: int = -1

    @classmethod
    def adopt(cls, old: Any) -> Self:  # noqa: ARG003 - what another node remembered is nothing to a player
        """Begin at the bag's beginning in the place of any node."""
        return cls()


class Player(Node):
    """Publish what the node of this name published when a bag was recorded."""

    params: PlayerParams
    state: PlayerState
    next_message_is_due = Alarm()

    _messages: Iterator[tuple[int, RecordedMessage]]
    _next: tuple[int, RecordedMessage] | None
    _bag: Bag | None = None
    _ports: Mapping[str, str] = {}
    _instant_ns = -1
    _round = 0

    @classmethod
    def shaped(cls, name: str, params: Mapping[str, Any]) -> type[Node]:
        path = params.get("bag")
        if not isinstance(path, str):
            return cls  # the check of the parameters reports it
        with Bag(path) as bag:
            known = playable(bag)
            mine = {port: known[topic] for port, topic in _outputs(name, params, known).items()}
            if not mine:
                there = sorted({topic.split("/")[1] for topic in known})
                raise BagError(
                    f"{path} has no messages of a node '{name}' that could be played; it has those of: "
                    f"{', '.join(there) or 'none'}"
                )
            return _player_class(cls, name, mine)

    def on_configure(self) -> None:
        self._open()

    def on_activate(self) -> None:
        now_ns = self.now_ns()
        self.state.begin_ns = now_ns if now_ns > TOGETHER_NS else 0
        self._go_on()

    def on_resume(self) -> None:
        if self.state.begin_ns < 0:
            self.state.begin_ns = self.now_ns()
        for _ in range(self.state.played_count):
            self._next = next(self._messages, None)
        self._go_on()

    def on_cleanup(self) -> None:
        self._close()

    def on_shutdown(self) -> None:
        self._close()

    @on(next_message_is_due)
    def _play(self) -> None:  # no name that a recorded port could have
        self._round += 1
        self._go_on()

    def _open(self) -> None:
        self._bag = Bag(self.params.bag)
        self._last_ns = span_ns(self._bag)[1]
        self._first_ns = begin_ns(self._bag, self.params.start_offset_s)
        outputs = _outputs(self.name, {"topics": self.params.topics}, playable(self._bag))
        self._ports = {topic: port for port, topic in outputs.items()}
        self._messages = self._mine(self._bag)
        self._next = next(self._messages, None)

    def _mine(self, bag: Bag) -> Iterator[tuple[int, RecordedMessage]]:
        """Yield this node's messages, each with the round of its instant."""
        rounds = Rounds.of(bag)
        shown = [topic for topic in bag.topics() if topic.startswith("/") and "/_" not in topic]
        for message in bag.recorded(shown, start_ns=self._first_ns):
            name = message.stream.topic.name
            place = rounds(message.log_ns, name)
            if name in self._ports:
                yield place, message

    def _close(self) -> None:
        if self._bag is not None:
            self._bag.close()

    def _go_on(self) -> None:
        """Publish everything that is due, and set the alarm for what comes next."""
        while self._next is not None:
            place, message = self._next
            due_ns = self._due_ns(message.publish_ns)
            if due_ns > self.now_ns():
                self.next_message_is_due.set(due_ns)
                return
            if message.log_ns != self._instant_ns:
                self._instant_ns, self._round = message.log_ns, 0
            if place > self._round:
                late = self.now_ns() > due_ns  # as always on the wall clock and never in lockstep
                self.next_message_is_due.set(self.now_ns() + (ROUND_GAP_NS if late else 0))
                return
            publisher: PublisherEnd[Any] = getattr(self, self._ports[message.stream.topic.name])
            if publisher.sequence >= publisher.room:
                publisher.wait_for_room()
            self.state.played_count += 1
            publisher.forward(message.payload)
            self._next = next(self._messages, None)
        end_ns = self._due_ns(self._last_ns) + round(self.params.hold_s * 1e9)
        if self.params.hold_s and end_ns > self.now_ns():
            self.next_message_is_due.set(end_ns)
        else:
            self.finish()

    def _due_ns(self, recorded_ns: int) -> int:
        since_ns = max(recorded_ns - self._first_ns, 0)
        return self.state.begin_ns + round(since_ns / self.params.rate)
