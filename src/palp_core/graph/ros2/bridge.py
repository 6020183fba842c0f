"""``palp bridge ros2``: what a map lets cross between a running graph and ROS 2, in a process of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Self

from palp_core.errors import GraphError, PalpError
from palp_core.graph.bag.ros2.values import writer
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.frame import Frame
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic
from palp_core.graph.ros2.maps import Times, as_plain
from palp_core.graph.ros2.message_types import known_types, message_type
from palp_core.graph.ros2.middleware import Middleware
from palp_core.graph.ros2.parameters import NodeParameters
from palp_core.graph.ros2.plan import Crossing
from palp_core.graph.ros2.ports import Account, Ports
from palp_core.graph.ros2.services import caller, offer

CLOCK = "rosgraph_msgs/msg/Clock"
CLOCK_NS = 10_000_000
ANSWERS_S = 0.1
MOST_PUBLISHERS = 1000
LAST = 2**62

Send = Callable[[Frame, Times], None]


@dataclass
class _Outlet:
    """What takes messages of a topic: from the one after ``last``, by epoch and sequence, on."""

    send: Send
    account: Account
    last: tuple[int, int] = (-1, 0)


def clock_offset_ns(graph: RunningGraph) -> int:
    """Return what ROS 2's clock, which counts from 1970, is ahead of a graph's; 0 in simulated time."""
    if graph.record.clock == "sim":
        return 0
    asked = graph.ask("graph", "clock")
    start_ns: int = asked["monotonic_ns"] - asked["now_ns"]  # of the graph, on the host's monotonic clock
    return unix_ns() - (monotonic_ns() - start_ns)


class Ros2Bridge:
    def __init__(
        self,
        graph: RunningGraph,
        crossings: Iterable[Crossing],
        report: Callable[[str], None],
    ) -> None:
        self._graph, self._report = graph, report
        self._offset_ns = clock_offset_ns(graph)
        self.ended = self.interrupted = False
        self.accounts: list[Account] = []
        self._outlets: dict[str, list[_Outlet]] = {}
        self._clock_ns, self._clock_due_ns = 0, 0
        self._reader = TopicReader(graph, [], reliable=True)
        self._ports = Ports(graph)
        self.name = re.sub(r"\W", "_", f"{graph.record.graph}_bridge")
        self._ros = Middleware(self.name, report)
        try:
            self._ros.topics.create_timer(ANSWERS_S, self._ports.turn)
            self._publish_clock = self._clock_publisher() if graph.record.clock == "sim" else None
            self._add(crossings)
        except BaseException:
            self._ros.close()
            self._reader.__exit__()
            raise

    def _add(self, crossings: Iterable[Crossing]) -> None:
        """Let what is planned cross; what ROS 2 has no type for is left out."""
        for crossing in crossings:
            entry = crossing.entry
            try:
                self._begin(crossing)
            except GraphError as error:
                self._report(f"{entry.mark}: {entry.name}: {error}")

    def _begin(self, crossing: Crossing) -> None:
        entry, topic = crossing.entry, crossing.topic
        if entry.kind == "parameters":
            node = entry.nodes[0]
            NodeParameters(self._graph, node, self._ros.node(node))
            return
        account = Account(entry.name)
        services = f"{self.name}_services"
        if entry.kind == "service":
            offer(self._graph, entry, self._ros.node(services), self._now, account)
        elif topic is None:
            self._subscribe(crossing, account)
        else:
            send = (
                self._sender(crossing, account)
                if entry.kind == "to_ros2"
                else caller(self._graph, entry, self._ros.node(services), account)
            )
            outlet = _Outlet(send, account)
            self._outlets.setdefault(topic.name, []).append(outlet)
            self._reader.follow([topic])
            self.accounts.append(account)
            if crossing.qos.durability == "transient_local" and entry.kind == "to_ros2":
                self._publish_latched(topic, outlet)
            return
        self.accounts.append(account)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ros.close()
        self._ports.close()
        self._reader.__exit__()
        self._report_losses(at_once=True)

    def interrupt(self, *_: object) -> None:
        """End :meth:`run`: a handler of signals."""
        self.interrupted = True
        raise KeyboardInterrupt

    def run(self) -> None:
        while not self._reader.ended:
            self._reader.turn(self._take)
            self._report_losses()
            if self.interrupted:
                raise KeyboardInterrupt
        self.ended = True

    def _take(self, received: ReceivedFrame) -> None:
        frame = received.frame
        if received.lost:
            for outlet in self._outlets.get(frame.topic, ()):
                outlet.account.lose(received.lost)
        if received.is_message:
            self._tick(frame.stamp_ns)
            for outlet in self._outlets.get(frame.topic, ()):
                if (frame.epoch, frame.sequence) > outlet.last:
                    outlet.send(frame, Times(frame.stamp_ns, self._offset_ns))

    def _report_losses(self, *, at_once: bool = False) -> None:
        for account in self.accounts:
            account.report(self._report, at_once=at_once)

    def _now(self) -> Times:
        simulated = self._publish_clock is not None
        return Times(self._clock_ns if simulated else unix_ns() - self._offset_ns, self._offset_ns)

    def _sender(self, crossing: Crossing, account: Account) -> Send:
        entry = crossing.entry
        publish = self._ros.publisher(entry.ros, entry.ros_type, crossing.qos)
        encode = writer(known_types(), entry.ros_type)

        def send(frame: Frame, times: Times) -> None:
            try:
                with entry.catch():
                    for _, message in entry.to_ros2(frame.payload, times):
                        publish(encode(message))
            except PalpError as error:
                account.refuse(str(error))
            else:
                account.cross()

        return send

    def _publish_latched(self, topic: Topic, outlet: _Outlet) -> None:
        for frame in self._graph.history(topic.node, topic.name):
            outlet.send(frame, Times(frame.stamp_ns, self._offset_ns))
            outlet.last = (frame.epoch, frame.sequence)

    def _subscribe(self, crossing: Crossing, account: Account) -> None:
        entry, decode = crossing.entry, known_types().store.deserialize_cdr
        _, node, port = entry.palp.split("/")
        numbers: dict[Any, int] = {}

        def arrived(data: bytes, info: dict[str, Any]) -> None:
            publisher = (info.get("publisher_gid") or {}).get("data")
            number = info.get("publication_sequence_number") or 0
            if number and publisher is not None:
                account.lose(max(number - numbers.get(publisher, number - 1) - 1, 0))
                if publisher not in numbers and len(numbers) >= MOST_PUBLISHERS:
                    numbers.clear()
                numbers[publisher] = number
            try:
                with entry.catch():
                    message = as_plain(entry.convert(decode(data, entry.ros_type), self._now()))
                    self._ports.publish(node, port, message, account)
            except PalpError as error:
                account.refuse(str(error))
            self._ports.turn()

        self._ros.subscribe(entry.ros, entry.ros_type, crossing.qos, arrived)

    def _clock_publisher(self) -> Callable[[int], None]:
        encode, clock = writer(known_types(), CLOCK), message_type(CLOCK)
        publish = self._ros.publisher("/clock", CLOCK, Qos(reliability="best_effort", depth=1))
        return lambda ns: publish(encode(clock(clock=Times(ns).to_ros2(ns))))

    def _tick(self, stamp_ns: int) -> None:
        """Publish simulated time before what is published at that time, at most a hundred times a second."""
        if self._publish_clock is None or stamp_ns <= self._clock_ns:
            return
        now_ns = monotonic_ns()
        if now_ns >= self._clock_due_ns:
            self._clock_due_ns, self._clock_ns = now_ns + CLOCK_NS, stamp_ns
            self._publish_clock(stamp_ns)
