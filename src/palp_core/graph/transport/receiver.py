"""What comes into a node on the wall clock: sockets, order, gaps, queues, silence, and the account."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import (
    HEADER_BYTES,
    PLAIN_DATA,
    Frame,
    Kind,
    checked_pieces,
    parse,
    quick_header,
)
from palp_core.graph.messages.qos import strictest
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.lifecycle import Lifecycle
from palp_core.graph.node.qos_events import EventEnd
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.process.swap_participant import Heard
from palp_core.graph.transport.merging import merged
from palp_core.graph.transport.migration import Migration
from palp_core.graph.transport.offsets import Offsets
from palp_core.graph.transport.reorder_buffer import ReorderBuffer
from palp_core.graph.transport.requester_socket import RequesterSocket
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

MOST_UNREAD = 100_000
MOST_UNREAD_BYTES = 256 << 20
RATE_WINDOW_NS = 1_000_000_000


class Receiver:
    """The receiving side of a node.

    Args:
        executor: The node. Times here are on the host's monotonic clock, not on the graph's.
        publishers: Per input topic, where it is published and where its publisher answers.
        context: The process's ZeroMQ context.
        ledger: File of what a predecessor has taken up and what this process does; None: not kept.
        listening: Is told a topic and the second place where it is listened to.

    Attributes:
        more: The last :meth:`take` left something in the socket.
    """

    def __init__(
        self,
        executor: Executor,
        publishers: Mapping[str, tuple[str, str]],
        context: Any,
        offsets: Path | None,
        listening: Callable[[str, str], None] = lambda *_: None,
    ) -> None:
        self.more = False
        self._executor, self._inbox = executor, executor.inbox
        places = {name: publish for name, (publish, _) in publishers.items()}
        self._subscriber = SubscriberSocket(places, context, name=executor.name)
        self._requester = RequesterSocket(context)
        self._offsets = Offsets(offsets, list(executor.ends.inputs)) if offsets is not None else None
        self._buffers = {name: self._buffer_of(name, wired) for name, wired in executor.ends.inputs.items()}
        self._migration = Migration(self._subscriber, publishers, self._buffers, listening)
        self._unread_bytes = 0
        self._silent: set[str] = set()
        self._rates = dict.fromkeys(self._buffers, (0, 0, 0.0))
        self._was_active = False
        self._quick: dict[bytes, tuple[ReorderBuffer, Subscription]] = {}
        self._start_ns = 0

    def _buffer_of(self, name: str, wired: list[Subscription]) -> ReorderBuffer:
        if self._offsets is not None and self._executor.spec.epoch > 0:
            for one in wired:
                one.account.epoch, one.account.sequence = self._offsets.read(name)
        qos = strictest([one.qos for one in wired])
        return ReorderBuffer(name, qos, wired[0].account, self._deliver, self._ask, ordered=wired[0].ordered)

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Descriptors that become readable when :meth:`take` has something to do."""
        return (self._subscriber.file_descriptor, *self._requester.file_descriptors)

    @property
    def matched(self) -> bool:
        """True once every publisher has been heard, and late joiners have what they ask for."""
        return all(buffer.matched for buffer in self._buffers.values())

    @property
    def heard(self) -> Heard:
        """Up to where each publisher's messages have been received."""
        return {
            name: (buffer.epoch, buffer.next - 1)
            for name, buffer in self._buffers.items()
            if buffer.is_ordered
        }

    def succeed(self, hand_over: HandOver) -> int:
        """Go on where a predecessor was, whose unread messages are in the inbox, behind this process's own.

        Raises:
            SchemaMismatch: A message was heard by neither.
        """
        frames = merged(self._inbox, hand_over, self._buffers, self._executor.ends.inputs)
        self._inbox.clear()
        self._unread_bytes = 0
        for frame in frames:
            self._deliver(frame)
        if self._offsets is not None:
            for name, counter in hand_over.consumed.items():
                if name in self._buffers:
                    self._offsets.note(name, counter.epoch, counter.sequence)
        return len(frames)

    def begin(self, start_ns: int) -> None:
        """Learn when the graph has started: what arrives is late from then on."""
        for buffer in self._buffers.values():
            buffer.origin_ns = self._start_ns = start_ns
        inputs = self._executor.ends.inputs
        if any(wired.qos.reliability == "best_effort" for several in inputs.values() for wired in several):
            return  # such a reader must see all that has arrived before it knows what to skip
        self._quick = {
            name.encode(): (self._buffers[name], wired[0])
            for name, wired in inputs.items()
            if len(wired) == 1 and wired[0].is_simple
        }

    def hear(self, endpoint: str) -> None:
        """Let a doorbell end the waiting of :meth:`take`."""
        self._subscriber.hear(endpoint)

    @property
    def asking(self) -> bool:
        """True once anything was asked of a publisher: its answers come on other descriptors."""
        return bool(self._requester.file_descriptors)

    def take(self, slice_ns: int, wait_ms: int = 0) -> bool:
        """Take in what has arrived, put it in order, ask for what is missing; tell if the doorbell rang.

        What is next in its order is handed to the node at once, for a slice of time; then the rest waits in
        the socket, whose queue is bounded: what does not fit is a gap, and is asked for or counted.
        ``wait_ms`` is how long to wait for something to arrive.
        """
        if self._inbox_is_full():
            return False
        self.more, rung = self._subscriber.take(self._arrive, slice_ns, wait_ms)
        self._take_answers()
        return rung

    def _take_answers(self) -> None:
        if not self._requester.file_descriptors:
            return
        now_ns = monotonic_ns()
        for reply in self._requester.replies():
            buffer = self._buffers.get(reply.get("topic", ""))
            if buffer is not None:
                buffer.fill(reply["epoch"], [parse(raw) for raw in reply["frames"]], now_ns)

    def _inbox_is_full(self) -> bool:
        return len(self._inbox) >= MOST_UNREAD or self._unread_bytes >= MOST_UNREAD_BYTES

    def _arrive(self, raw: bytes, now_ns: int) -> None:
        """Take one frame; nearly every one is a message that is next in its order, and goes the short way."""
        end = raw.find(0)
        edge = self._quick.get(raw[:end])
        executor = self._executor
        if edge is not None and len(raw) > end + HEADER_BYTES and not self._inbox and executor.publishing:
            buffer, wired = edge
            head, epoch, sequence, stamp_ns, type_hash = quick_header(raw, end + 1)
            if (
                head == PLAIN_DATA
                and sequence == buffer.next
                and epoch == buffer.epoch
                and type_hash == wired.type_hash
                and buffer.give_up_ns is None
                and executor.exit_code is None
            ):
                graph_ns = now_ns - self._start_ns
                executor.take(wired, epoch, sequence, memoryview(raw)[end + 1 + HEADER_BYTES :], graph_ns)
                buffer.next = sequence + 1
                buffer.heard_ns = buffer.data_ns = now_ns
                buffer.latency.add(graph_ns - stamp_ns)
                if self._offsets is not None:
                    self._offsets.note(buffer.topic, epoch, sequence)
                return
        self._sort(raw, now_ns)

    def _sort(self, raw: bytes, now_ns: int) -> None:
        """Take a frame the long way: one in pieces, a heartbeat, one out of order, or none of ours."""
        rest = self._subscriber.rest()
        try:
            frame = parse(raw)
            if rest:
                frame = frame._replace(rest=checked_pieces(rest))
            buffer = self._buffers.get(frame.topic)
            if buffer is None:
                raise SchemaMismatch(f"{frame.topic} is no input of {self._executor.name}")
            if frame.kind == Kind.MOVED:
                self._migration.take(frame, now_ns)
                self._requester.keep(self._migration.servers.values())
                return
        except SchemaMismatch as error:
            self._executor.events.reject(error)
            return
        buffer.arrive(frame, now_ns)

    def _ask(self, topic: str, first: int, last: int) -> None:
        node = topic.split("/")[1]
        request = {"op": "history", "node": node, "topic": topic, "first": first, "last": last}
        self._requester.ask(self._migration.servers[topic], request)

    def _deliver(self, frame: Frame) -> None:
        self._inbox.append(frame)
        self._unread_bytes += frame.payload_bytes
        self._was_active = self._was_active or self._executor.lifecycle is Lifecycle.ACTIVE
        if self._was_active and not self._executor.is_active and frame.kind == Kind.DATA:
            self._retain(self._buffers[frame.topic])

    def _retain(self, buffer: ReorderBuffer) -> None:
        """Keep no more than ``depth`` messages for a node that was deactivated; the oldest go first."""
        if buffer.unread <= buffer.qos.depth:
            return
        for i, frame in enumerate(self._inbox):
            if frame.topic == buffer.topic and frame.kind == Kind.DATA:
                del self._inbox[i]
                self._drop(buffer, frame)
                return

    def hand_over_next(self) -> None:
        """Hand the next frame to the node; a best-effort reader skips to its last ``depth``."""
        frame = self._inbox.popleft()
        buffer = self._buffers.get(frame.topic)
        if buffer is None or frame.kind != Kind.DATA:
            self._executor.consume(frame)
            return
        if buffer.unread > buffer.qos.depth and buffer.qos.reliability == "best_effort":
            self._drop(buffer, frame)
            return
        buffer.unread -= 1
        self._unread_bytes -= frame.payload_bytes
        self._executor.consume(frame)
        if self._offsets is not None:
            self._offsets.note(frame.topic, frame.epoch, frame.sequence)

    def _drop(self, buffer: ReorderBuffer, frame: Frame) -> None:
        buffer.unread -= 1
        self._unread_bytes -= frame.payload_bytes
        for wired in self._executor.ends.inputs[frame.topic]:
            wired.account.drop(frame.epoch, frame.sequence)

    def keep_house(self, now_ns: int, graph_ns: int, late_ns: int) -> None:
        """Look for silence, give up what cannot be had; due ten times a second, and now so late."""
        self._migration.tick(now_ns)
        for name, buffer in self._buffers.items():
            buffer.pardon(late_ns, now_ns)
            buffer.expire(now_ns)
            count, since_ns, _ = self._rates[name]
            if now_ns - since_ns >= RATE_WINDOW_NS:
                rate_hz = (buffer.latency.count - count) / (now_ns - since_ns) * 1e9
                self._rates[name] = (buffer.latency.count, now_ns, rate_hz)
            for wired in self._executor.ends.inputs[name]:
                if wired.qos.lease_ms:
                    self._watch(buffer, wired, now_ns, graph_ns)

    def _watch(self, buffer: ReorderBuffer, wired: Subscription, now_ns: int, graph_ns: int) -> None:
        if self._executor.lifecycle is not Lifecycle.ACTIVE:
            return
        asserted_ns = buffer.data_ns if wired.qos.liveliness == "manual_by_topic" else buffer.heard_ns
        silent = now_ns - asserted_ns > wired.qos.lease_ms * 1e6
        if silent != (wired.port in self._silent):
            self._silent ^= {wired.port}
            end = self._executor.ends.timers[f"liveliness:{wired.port}"]
            assert isinstance(end, EventEnd)
            end.count(1, graph_ns)

    def account(self, window: int = 0) -> dict[str, dict[str, Any]]:
        """Return what the node counts not itself; latencies of the last ``window`` messages if not 0."""
        return {
            name: {
                "filled": buffer.filled,
                "unread": buffer.unread,
                "rate_hz": self._rates[name][2],
                "latency_s": buffer.latency.summary_s() if buffer.latency.count else None,
                **({"recent_latency_s": buffer.latency.recent_s(window)} if window > 0 else {}),
            }
            for name, buffer in self._buffers.items()
        }

    @property
    def buffers(self) -> Mapping[str, ReorderBuffer]:
        """Every edge's reception, by topic."""
        return self._buffers

    def close(self) -> None:
        """Let go."""
        self._subscriber.close()
        self._requester.close()
        if self._offsets is not None:
            self._offsets.close()
