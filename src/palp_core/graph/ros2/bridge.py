"""``palp bridge ros2``: what a map says crosses between a running graph and ROS 2, beside both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import msgspec

from palp_core.errors import BagError, GraphError
from palp_core.graph.bag.ros2.values import reader, writer
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.frame import Frame, parse
from palp_core.graph.messages.qos import Qos
from palp_core.graph.ros2.account import Account
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.joining import Joining
from palp_core.graph.ros2.middleware import Middleware
from palp_core.graph.ros2.parameters import ParameterServices
from palp_core.graph.ros2.plan import BridgePlan, TopicToPalp, TopicToRos2
from palp_core.graph.ros2.services import Services
from palp_core.graph.ros2.to_palp import Ports

CLOCK = "rosgraph_msgs/msg/Clock"
CLOCK_NS = 10_000_000
MOST_PUBLISHERS = 1000
LAST = 2**62
_BEFORE = (-1, 0)
NS = 1_000_000_000


def graph_times(graph: RunningGraph) -> Times:
    """Return how a graph's time becomes ROS 2's: on the wall clock since 1970, simulated as it is."""
    if graph.record.clock == "sim":
        return Times()
    told = graph.ask("graph", "clock")
    start_ns = told["monotonic_ns"] - told["now_ns"]  # of the graph, on the host's monotonic clock
    offset_ns = unix_ns() - (monotonic_ns() - start_ns)
    return Times(lambda ns: ns + offset_ns, lambda ns: ns - offset_ns)


class Ros2Bridge:
    """The bridge, from its beginning to its end.

    Args:
        graph: The graph.
        plan: What crosses.
        times: What becomes of times.
        name: What it is called in ROS 2.
        clock: Whether the graph's time is published as ``/clock``.
        say: Told what is lost or refused.

    Attributes:
        ended: The graph has ended.
        interrupted: Somebody wants the bridge to end.

    Raises:
        GraphError: ROS 2 cannot be begun, or a type is not to be had.
    """

    def __init__(
        self,
        graph: RunningGraph,
        plan: BridgePlan,
        times: Times,
        *,
        name: str,
        clock: bool,
        say: Callable[[str], None],
    ) -> None:
        self._graph, self._times, self._say, self._name = graph, times, say, name
        self._definitions = plan.definitions
        self._joining = Joining(graph, plan.awaited, plan.definitions, times, say)
        self.ended = self.interrupted = False
        self._accounts: list[Account] = []
        self._senders: dict[str, list[_Sender]] = {}
        self._latched: dict[str, tuple[int, int]] = {}
        self._latest_ns, self._clock_told_ns, self._clock_due_ns = 0, 0, 0
        self._reader = TopicReader(graph, [], reliable=True)
        self._ports = Ports(graph)
        self._parameters = ParameterServices(graph)
        self._services = Services(graph, plan.definitions, times, self._account)
        self._ros = Middleware(name, plan.definitions, self._ports.turn)
        try:
            self._tell_clock = self._clock_publisher() if clock else None
            self._ros.serve("topics", self._ros.topics)
            self._add(plan)
        except BaseException:
            self._ros.close()
            self._reader.__exit__()
            raise

    def _add(self, plan: BridgePlan) -> None:
        """Let what a plan says cross from now on."""
        for entry in plan.to_ros2:
            self._senders.setdefault(entry.topic.name, []).append(self._sender(entry))
        self._reader.follow([*(entry.topic for entry in plan.to_ros2), *(call.topic for call in plan.calls)])
        for way in plan.to_palp:
            self._subscribe(way)
        if plan.services or plan.calls:
            self._services.add(plan, self._ros.served("services", f"{self._name}_services"))
        for name in plan.parameters:
            self._parameters.serve(name, self._ros.served("services", name))
        self._say_what_stands(plan)

    def _let_join(self) -> None:
        """Let what the map says of nodes that have joined since cross, too."""
        plan = self._joining.plan()
        if plan is None:
            return
        try:
            self._add(plan)
        except GraphError as error:
            self._say(str(error))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ros.close()
        self._ports.close()
        self._services.close()
        self._reader.__exit__()
        self.tell(at_once=True)

    @property
    def accounts(self) -> list[Account]:
        """Of every way."""
        return self._accounts

    def interrupt(self, *_: object) -> None:
        """End :meth:`run`: what a signal calls."""
        self.interrupted = True
        raise KeyboardInterrupt

    def run(self) -> None:
        """Carry messages over until the graph ends.

        Raises:
            KeyboardInterrupt: :attr:`interrupted` was set; what raised it may have been swallowed on the way.
        """
        while not self._reader.ended:
            self._reader.turn(self._take)
            self.tell()
            self._let_join()
            if self.interrupted:
                raise KeyboardInterrupt
        self.ended = True

    def _take(self, received: ReceivedFrame) -> None:
        frame = received.frame
        if received.lost:
            for sender in self._senders.get(frame.topic, ()):
                sender.account.lose(received.lost)
        if received.is_message:
            self._tell_time(frame.stamp_ns)
            if (frame.epoch, frame.sequence) > self._latched.get(frame.topic, _BEFORE):
                self._carry(frame)

    def tell(self, *, at_once: bool = False) -> None:
        """Say what has been lost or refused since."""
        for account in self._accounts:
            account.tell(self._say, at_once=at_once)

    def _account(self, name: str) -> Account:
        self._accounts.append(Account(name))
        return self._accounts[-1]

    def _carry(self, frame: Frame) -> None:
        for sender in self._senders.get(frame.topic, ()):
            sender.send(frame)
        self._services.ask_of(frame)

    def _sender(self, entry: TopicToRos2) -> _Sender:
        way = entry.crossing.way
        publish = self._ros.publisher(way.ros, entry.crossing.type, entry.qos)
        encode = writer(self._definitions, entry.crossing.type)
        return _Sender(entry, encode, publish, self._account(f"{way.palp} -> {way.ros}"))

    def _say_what_stands(self, plan: BridgePlan) -> None:
        """Publish what the graph's latched topics hold; what comes up to there is said then."""
        latched = {e.topic.name: e.topic for e in plan.to_ros2 if e.qos.durability == "transient_local"}
        for topic in latched.values():
            asked: dict[str, Any] = {"topic": topic.name, "first": 1, "last": LAST}
            reply = self._graph.ask(topic.node, "history", **asked)
            frames = [parse(raw) for raw in reply["frames"]]
            for frame in frames:
                self._carry(frame)
                self._latched[frame.topic] = (frame.epoch, frame.sequence)

    def _subscribe(self, entry: TopicToPalp) -> None:
        way, convert = entry.crossing.way, entry.crossing.convert
        account = self._account(f"{way.ros} -> {way.palp}")
        decode = reader(self._definitions, entry.crossing.type)
        numbers: dict[Any, int] = {}

        def arrived(data: bytes, publisher: Any, number: int) -> None:
            if number and publisher is not None:
                account.lose(max(number - numbers.get(publisher, number - 1) - 1, 0))
                if publisher not in numbers and len(numbers) >= MOST_PUBLISHERS:
                    numbers.clear()
                numbers[publisher] = number
            try:
                for _, message in convert(decode(data), self._times.to_palp(unix_ns())):
                    self._ports.publish(entry.node, entry.port, message, account)
            except (BagError, GraphError, LookupError, ValueError) as error:
                account.refuse(_words(error))

        self._ros.subscribe(way.ros, entry.crossing.type, entry.qos, arrived)

    def _clock_publisher(self) -> Callable[[int], None]:
        encode = writer(self._definitions, CLOCK)
        publish = self._ros.publisher("/clock", CLOCK, Qos(reliability="best_effort", depth=1))

        def tell(ns: int) -> None:
            sec, nanosec = divmod(self._times.to_ros(ns), NS)
            publish(encode({"clock": {"sec": sec, "nanosec": nanosec}}))

        return tell

    def _tell_time(self, stamp_ns: int) -> None:
        """Tell the graph's time before what is said then, at most a hundred times a second."""
        if self._tell_clock is None or stamp_ns <= self._clock_told_ns:
            return
        now_ns = monotonic_ns()
        if now_ns >= self._clock_due_ns:
            self._clock_due_ns, self._clock_told_ns = now_ns + CLOCK_NS, stamp_ns
            self._tell_clock(stamp_ns)


class _Sender:
    """One topic on its way to ROS 2."""

    def __init__(
        self,
        entry: TopicToRos2,
        encode: Callable[[Any], bytes],
        publish: Callable[[bytes], None],
        account: Account,
    ) -> None:
        self._convert, self._encode, self._publish = entry.crossing.convert, encode, publish
        self._decode = msgspec.msgpack.Decoder().decode
        self.account = account

    def send(self, frame: Frame) -> None:
        try:
            for _, message in self._convert(self._decode(frame.payload), frame.stamp_ns):
                self._publish(self._encode(message))
        except (BagError, LookupError, ValueError, TypeError, msgspec.MsgspecError) as error:
            self.account.refuse(_words(error))
        else:
            self.account.cross()


def _words(error: Exception) -> str:
    return f"it has no such element: {error}" if isinstance(error, LookupError) else str(error)
