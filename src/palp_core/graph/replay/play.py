"""Play a bag: a :class:`Player` for each recorded node, all in this process, in simulated time with a pace.

So messages come in the recorded rounds as in a lockstep graph, and pause and rate are those of the clock.
They go into a run of their own, or into ports of a running graph.
"""

import contextlib
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError, GraphError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.clock import SimClock
from palp_core.graph.discovery.run_directory import NodeEntry, RunDirectory
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.latency import Latency
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.topic import Topic, topic_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import LAUNCHER, NodeSpec
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.replay.player import TOGETHER_NS, Player, begin_ns, span_ns
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.publisher_socket import HEARTBEAT_NS

GRAPH = "play"
PROCESS = "player"
RUN = "palp_core.graph.replay.player:Player"
SLOWEST, FASTEST = 1e-2, 1e3
SLICE = 100  # instants that are due at once, before anybody who asks is answered


class Playback(contextlib.AbstractContextManager["Playback"]):
    """The players of a bag, and the clock that they share.

    ``names`` are recorded topics and the names under which they are played. Of both limits, ``duration_s``
    and the log time ``until_s``, the earlier one counts.
    """

    def __init__(
        self,
        bag: Bag,
        names: Mapping[str, str],
        *,
        rate: float = 1.0,
        start_offset_s: float = 0.0,
        duration_s: float | None = None,
        until_s: float | None = None,
        loop: bool = False,
    ) -> None:
        first_ns, last_ns = span_ns(bag)
        start_ns = begin_ns(bag, start_offset_s)
        limits_ns = [last_ns if until_s is None else round(until_s * 1e9)]
        if duration_s is not None:
            limits_ns.append(start_ns + round(duration_s * 1e9))
        self.span_ns = min(limits_ns) - start_ns  # what is played, in the bag's time
        if next(bag.recorded(names, start_ns=start_ns, end_ns=start_ns + self.span_ns + 1), None) is None:
            span = f"{first_ns / 1e9:.3f} .. {last_ns / 1e9:.3f} s"
            raise BagError(f"{bag.path}: no message of the chosen topics and time; the bag has {span}")
        by_node: dict[str, dict[str, str]] = {}
        for old, new in names.items():
            _, node, port = new.split("/")
            by_node.setdefault(node, {})[port] = old
        self.rate, self.paused = rate, False
        self.lateness = Latency()  # of each instant at which there were messages
        self.send: Callable[[bytes], None] = lambda _: None
        self._loop = loop
        self._begin_ns = 0  # of this turn of a loop, on the players' clock
        self._at_ns = self._now_ns = 0  # a moment on the players' clock and on the machine's
        self.clock = SimClock()
        self.executors = {
            node: Executor(Player, self._spec(bag, node, ports, start_offset_s), self.clock, self._send)
            for node, ports in by_node.items()
        }
        for executor in self.executors.values():
            executor.resend = self._send
            executor.transition(Transition.CONFIGURE)

    @staticmethod
    def _spec(bag: Bag, node: str, ports: Mapping[str, str], start_offset_s: float) -> NodeSpec:
        params = {"bag": str(bag.path), "topics": ports, "start_offset_s": start_offset_s, "hold_s": 0.0}
        return NodeSpec(name=node, run=RUN, params=params)

    def _send(self, frame: bytes) -> None:
        self.send(frame)

    def __exit__(self, *_: object) -> None:
        for executor in self.executors.values():
            executor.transition(Transition.SHUTDOWN)

    @property
    def played_count(self) -> int:
        return sum(executor.node.state.played_count for executor in self.executors.values())  # type: ignore[attr-defined]

    def start(self, now_ns: int) -> None:
        """Begin, at this time of the machine's monotonic clock."""
        self._at_ns, self._now_ns = self.clock.now_ns(), now_ns
        for executor in self.executors.values():
            executor.transition(Transition.ACTIVATE)

    def _next_ns(self) -> int | None:
        """Return when a player has something to do, on their clock; None: this turn is over."""
        due_ns = [due for executor in self.executors.values() if (due := executor.next_due_ns()) is not None]
        soonest = min(due_ns, default=None)
        return None if soonest is None or soonest > self._begin_ns + self.span_ns else soonest

    @property
    def finished(self) -> bool:
        return not self._loop and self._next_ns() is None

    def due_ns(self) -> int | None:
        """Return when :meth:`play_due` has something to do, on the machine's clock; None: not in a pause."""
        next_ns = self._next_ns()
        if self.paused or next_ns is None:
            return None if self.paused or not self._loop else self._now_ns
        return self._now_ns + math.ceil((next_ns - self._at_ns) / self.rate)

    def play_due(self, now_ns: int) -> None:
        """Publish what is due, for a slice."""
        for _ in range(SLICE):
            due_ns = self.due_ns()
            if due_ns is None or due_ns > now_ns:
                return
            if (next_ns := self._next_ns()) is None:
                self._begin_again(now_ns)
                continue
            self.lateness.add(now_ns - due_ns)
            self.clock.set(max(next_ns, self.clock.now_ns()))
            for executor in self.executors.values():
                executor.run_timers()

    def _begin_again(self, now_ns: int) -> None:
        self.clock.set(max(self.clock.now_ns(), TOGETHER_NS + 1))
        self._begin_ns = self.clock.now_ns()
        for executor in self.executors.values():
            for transition in (Transition.DEACTIVATE, Transition.CLEANUP, Transition.CONFIGURE):
                executor.transition(transition)
            executor.exit_code = None
        self.start(now_ns)

    def position_ns(self, now_ns: int) -> int:
        """Return how far playing is, in the bag's time; one that is late has not passed what is due."""
        next_ns = self._next_ns()
        moved_ns = 0 if self.paused else round((now_ns - self._now_ns) * self.rate)
        at_ns = self._at_ns + moved_ns
        return min(at_ns if next_ns is None else min(at_ns, next_ns), self._begin_ns + self.span_ns) - (
            self._begin_ns
        )

    def toggle(self, now_ns: int) -> None:
        self._rebase(now_ns)
        self.paused = not self.paused

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Go on at another speed, within what is sensible."""
        self._rebase(now_ns)
        self.rate = min(max(rate, SLOWEST), FASTEST)

    def _rebase(self, now_ns: int) -> None:
        self._at_ns = self._begin_ns + self.position_ns(now_ns)
        self._now_ns = now_ns


class PlayRun:
    """A run of its own, in which the recorded nodes seem to run: tools find them, their topics and types."""

    def __init__(self, source: Path, topics: Mapping[str, Topic], playback: Playback) -> None:
        with contextlib.ExitStack() as stack:
            directory = RunDirectory(GRAPH)
            stack.callback(directory.remove)
            where = str(directory.path)
            at = endpoints(where, PROCESS)
            self._sockets = NodeSockets(*at)
            stack.callback(self._sockets.close)
            self._launcher = LauncherNode(where, playback.clock.now_ns)
            stack.callback(self._launcher.close)
            playback.send = self._sockets.publisher.send
            messages = {}
            for node, executor in playback.executors.items():
                outputs = executor.ends.publishers.values()
                messages.update({out.topic: out.message for out in outputs})
                self._sockets.publisher.offer(outputs)
                self._sockets.requests.add(node, NodeServices(executor).operations(), CHANGING)
            nodes = [NodeEntry(node, RUN, os.getpid(), *at) for node in playback.executors]
            entries = [
                msgspec.structs.replace(
                    topic_of(name, messages[name], name.split("/")[1], at[0]), json_schema=topic.json_schema
                )
                for name, topic in topics.items()
            ]
            entries += LauncherNode.topics(where)
            serve = endpoints(where, LAUNCHER)[1]
            self._launcher.record = directory.record(GRAPH, str(source), "wall", serve, nodes, entries)
            directory.write(self._launcher.record)
            text = f"{source}: {counted(len(nodes), 'recorded node is', 'recorded nodes are')} played"
            self._launcher.report("started", "", text)
            self.file_descriptors = (*self._sockets.file_descriptors, *self._launcher.file_descriptors)
            self._stack = stack.pop_all()
        self._next_beat_ns = 0

    def poll(self, now_ns: int) -> bool:
        """Answer requests, without waiting; return whether there may be more."""
        if now_ns >= self._next_beat_ns:
            self._next_beat_ns = now_ns + HEARTBEAT_NS
            self._sockets.publisher.send_heartbeats()
        self._sockets.poll()
        self._sockets.requests.run_deferred()
        self._launcher.poll()
        return self._sockets.pending()

    def reader_count(self) -> int:
        return self._sockets.publisher.subscription_count

    def close(self) -> None:
        self._launcher.report("ending", "", "the bag has ended")
        self._sockets.publisher.send_heartbeats()
        self._stack.close()


def external_ports(graph: RunningGraph, topics: Mapping[str, Topic]) -> list[str]:
    """Return those of the topics that are ports of a running graph which take messages from outside."""
    known = graph.external_ports()
    taken = [name for name in topics if name in known]
    if not taken:
        raise GraphError(
            f"graph '{graph.record.graph}' takes none of the bag's topics from outside; it takes: "
            f"{', '.join(known) or 'none'}. Declare an input external: true in the launch file, or name "
            "one with --remap RECORDED:=/node/port"
        )
    for name in taken:
        if topics[name].type_hash not in ("", known[name]["type_hash"]):
            raise GraphError(f"{name} takes another type than {topics[name].type}; remap another topic to it")
    return taken


def publish_into(graph: RunningGraph, topics: Mapping[str, Topic], frame: bytes) -> None:
    """Publish a player's frame in a running graph, if it is of one of the topics."""
    parsed = parse(frame)
    if parsed.kind == Kind.DATA and parsed.topic in topics:
        _, node, port = parsed.topic.split("/")
        graph.ask(node, "publish", port=port, message=msgspec.msgpack.decode(parsed.payload))
