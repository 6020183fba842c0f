"""What comes into a node on the wall clock: sockets, order, gaps, queues, silence, and the account."""

import itertools
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.qos import MOST_UNREAD, strictest
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_reader import array_fields
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.lifecycle import Lifecycle
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.transport.acks import AckSender, flow_controls
from palp_core.graph.transport.migration import Migration
from palp_core.graph.transport.reorder_buffer import ReorderBuffer
from palp_core.graph.transport.requester_socket import RequesterSocket
from palp_core.graph.transport.restart_files import Offsets, ReceivedOffsets
from palp_core.graph.transport.subscriber_socket import ARRAY_QUEUE, RECEIVE_QUEUE, SubscriberSocket

_MOVED = int(Kind.MOVED)  # an enum costs a comparison in Python
MOST_UNREAD_BYTES = 64 << 20
RATE_WINDOW_NS = 1_000_000_000


class TopicReceiver:
    """The receiving side of a node."""

    def __init__(
        self,
        executor: Executor,
        publishers: Mapping[str, tuple[str, str]],
        context: Any,
        offsets: Path | None,
    ) -> None:
        self._executor, self._inbox = executor, executor.inbox
        places = {name: publish for name, (publish, _) in publishers.items()}
        self._subscriber = SubscriberSocket(
            places,
            context,
            _queue(executor.ends.subscriptions),
            name=executor.name,
            flow_controls=flow_controls(executor),
        )
        self._subscribed = (self._subscriber.file_descriptor,)
        self._requester = RequesterSocket(context)
        self._offsets = Offsets(offsets, list(executor.ends.subscriptions)) if offsets is not None else None
        self.buffers = {
            name: self._buffer_of(name, subscriptions)
            for name, subscriptions in executor.ends.subscriptions.items()
        }
        self._acks = AckSender(executor, self.buffers, self._subscriber.send_up)
        self._migration = Migration(self._subscriber, publishers, self.buffers)
        self._unread_bytes = 0
        self.monitor = EdgeMonitor(executor, self.buffers)
        self._was_active = False
        self._start_ns = 0

    def _buffer_of(self, name: str, subscriptions: list[Subscription]) -> ReorderBuffer:
        if self._offsets is not None and self._executor.spec.epoch > 0:
            for subscription in subscriptions:
                account = subscription.account
                account.epoch, account.sequence = self._offsets.read(name)
        qos = strictest([subscription.qos for subscription in subscriptions])
        return ReorderBuffer(
            name, qos, subscriptions[0].account, self._deliver, self._ask, ordered=subscriptions[0].is_ordered
        )

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Descriptors that become readable when :meth:`receive` has something to do."""
        return self._subscribed + self._requester.file_descriptors

    @property
    def matched(self) -> bool:
        """True once a frame of every publisher has come, and late joiners have what they ask for."""
        return all(buffer.matched for buffer in self.buffers.values())

    @property
    def received(self) -> ReceivedOffsets:
        """Up to where each publisher's messages have been received."""
        return {
            name: (buffer.epoch, buffer.next - 1)
            for name, buffer in self.buffers.items()
            if buffer.is_ordered
        }

    def continue_from(self, hand_over: HandOver, received: ReceivedOffsets) -> int:
        """Go on where a predecessor was, whose unread messages are in the inbox behind the own ones."""
        frames = _merged(self._inbox, hand_over, received, self.buffers, self._executor.ends.subscriptions)
        self._inbox.clear()
        self._unread_bytes = 0
        for frame in frames:
            self._deliver(frame)
        if self._offsets is not None:
            for name, account in hand_over.consumed.items():
                if name in self.buffers:
                    self._offsets.note(name, account.epoch, account.sequence)
        self._acks.begin()
        return len(frames)

    def set_start(self, start_ns: int) -> None:
        """Learn when the graph has started: what arrives is late from then on."""
        for buffer in self.buffers.values():
            buffer.origin_ns = self._start_ns = start_ns
        self._acks.begin()
        inputs = self._executor.ends.subscriptions
        several = itertools.chain.from_iterable(inputs.values())
        if any(subscription.qos.reliability == "best_effort" for subscription in several):
            return  # such a reader must see all that has arrived before it knows what to skip
        for name, subscriptions in inputs.items():
            if len(subscriptions) == 1 and subscriptions[0].is_prompt:
                self.buffers[name].prompt = subscriptions[0]
        # where a deadline holds, what is due at its time comes before a message that is late

    def pending(self) -> bool:
        """Return whether there is something to take in, whatever the descriptors show.

        They signal changes only, and sending a word or a question takes that signal away.
        """
        waits = self._subscriber.receive_pending or self._requester.pending()
        return waits and not self._inbox_is_full()

    def receive(self, slice_ns: int) -> None:
        """Take in what has arrived, put it in order, ask for what is missing.

        What is next in its order is handed to the node at once, for a slice of time; then the rest waits in
        the socket, whose queue is bounded: what does not fit is a gap, and is asked for or counted.
        """
        if not self._inbox_is_full():
            self._subscriber.dispatch(self._arrive, slice_ns)
            if self._requester.file_descriptors:
                self._take_answers()

    def _take_answers(self) -> None:
        now_ns = monotonic_ns()
        for reply in self._requester.replies():
            buffer = self.buffers.get(reply.get("topic", ""))
            if buffer is not None:
                buffer.fill(reply["epoch"], [parse(raw) for raw in reply["frames"]], now_ns)

    def _inbox_is_full(self) -> bool:
        return len(self._inbox) >= MOST_UNREAD or self._unread_bytes >= MOST_UNREAD_BYTES

    def _arrive(self, raw: bytes, now_ns: int) -> None:
        """Take one frame; a message that is next in its order goes to its handler at once."""
        executor = self._executor
        try:
            frame = parse(raw)
            buffer = self.buffers.get(frame.topic)
            if buffer is None:
                raise SchemaMismatch(f"{frame.topic} is not an input of {executor.name}")
            if frame.kind == _MOVED:
                self._migration.follow(frame, now_ns)
                self._requester.keep(self._migration.servers.values())
                self._acks.send_again(frame.topic)
                return
        except SchemaMismatch as error:
            executor.events.reject(error)
            return
        prompt = buffer.prompt
        if prompt is None or self._inbox or not executor.publishing or executor.exit_code is not None:
            buffer.arrive(frame, now_ns)
        elif buffer.take_next(frame, now_ns):
            executor.deliver(prompt, frame, now_ns - self._start_ns)
            if self._offsets is not None:
                self._offsets.note(buffer.topic, frame.epoch, frame.sequence)
            if frame.sequence >= buffer.ack_due:
                self._acks.send(buffer)
        else:
            buffer.sort(frame, now_ns)

    def _ask(self, topic: str, first: int, last: int) -> None:
        self._requester.ask_history(self._migration.servers[topic], topic, first, last)

    def _deliver(self, frame: Frame) -> None:
        self._inbox.append(frame)
        self._unread_bytes += len(frame.payload)
        self._was_active = self._was_active or self._executor.lifecycle is Lifecycle.ACTIVE
        if self._was_active and not self._executor.is_active and frame.kind == Kind.DATA:
            self._retain(self.buffers[frame.topic])

    def _retain(self, buffer: ReorderBuffer) -> None:
        """Keep no more than ``depth`` messages for a node that was deactivated; the oldest go first."""
        if buffer.unread <= buffer.qos.depth:
            return
        for i, frame in enumerate(self._inbox):
            if frame.topic == buffer.topic and frame.kind == Kind.DATA:
                del self._inbox[i]
                self._drop(buffer, frame)
                return

    def deliver_next(self) -> None:
        """Hand the next frame to the node; a best-effort reader skips to its last ``depth``."""
        frame = self._inbox.popleft()
        buffer = self.buffers.get(frame.topic)
        if buffer is None or frame.kind != Kind.DATA:
            self._executor.consume(frame)
            return
        if buffer.unread > buffer.qos.depth and buffer.qos.reliability == "best_effort":
            self._drop(buffer, frame)
            return
        buffer.unread -= 1
        self._unread_bytes -= len(frame.payload)
        self._executor.consume(frame)
        if self._offsets is not None:
            self._offsets.note(frame.topic, frame.epoch, frame.sequence)
        if frame.sequence >= buffer.ack_due:
            self._acks.send(buffer)

    def _drop(self, buffer: ReorderBuffer, frame: Frame) -> None:
        buffer.unread -= 1
        self._unread_bytes -= len(frame.payload)
        for subscription in self._executor.ends.subscriptions[frame.topic]:
            subscription.account.drop(frame.epoch, frame.sequence)

    def tick(self, now_ns: int, graph_ns: int, late_ns: int) -> None:
        """Look for silence, give up what cannot be had; due ten times a second, and now so late."""
        self._migration.tick(now_ns)
        for buffer in self.buffers.values():
            buffer.excuse_absence(late_ns, now_ns)
            buffer.expire(now_ns)
        self._acks.send_all(absent=self._is_absent())
        self.monitor.look(now_ns, graph_ns)

    def _is_absent(self) -> bool:
        """Return whether the node takes nothing up: it was deactivated, or is done."""
        executor = self._executor
        return executor.exit_code is not None or (self._was_active and not executor.is_active)

    def close(self) -> None:
        self._subscriber.close()
        self._requester.close()
        if self._offsets is not None:
            self._offsets.close()


class EdgeMonitor:
    """How the edges into a node do: rates, latencies, publishers that have fallen silent."""

    def __init__(self, executor: Executor, buffers: Mapping[str, ReorderBuffer]) -> None:
        self._executor, self._buffers = executor, buffers
        self._silent: set[str] = set()
        self._rates = dict.fromkeys(buffers, (0, 0, 0.0))

    def look(self, now_ns: int, graph_ns: int) -> None:
        """Measure rates over whole seconds, and raise the liveliness events of the active node."""
        for name, buffer in self._buffers.items():
            count, since_ns, _ = self._rates[name]
            if now_ns - since_ns >= RATE_WINDOW_NS:
                rate_hz = (buffer.latency.count - count) / (now_ns - since_ns) * 1e9
                self._rates[name] = (buffer.latency.count, now_ns, rate_hz)
            if self._executor.lifecycle is Lifecycle.ACTIVE:
                for subscription in self._executor.ends.subscriptions[name]:
                    if subscription.qos.lease_ms:
                        self._look_for_silence(buffer, subscription, now_ns, graph_ns)

    def _look_for_silence(
        self, buffer: ReorderBuffer, subscription: Subscription, now_ns: int, graph_ns: int
    ) -> None:
        qos, port = subscription.qos, subscription.port
        asserted_ns = buffer.data_ns if qos.liveliness == "manual_by_topic" else buffer.heard_ns
        silent = now_ns - asserted_ns > qos.lease_ms * 1e6
        if silent != (port in self._silent):
            self._silent ^= {port}
            self._executor.ends.events["liveliness", port].count(1, graph_ns)

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


def _queue(subscriptions: Mapping[str, list[Subscription]]) -> int:
    """Return how many messages may wait in the socket: ZeroMQ counts them; large ones take several places.

    The rest waits at the publisher, which counts the bytes of large ones; what it has no room for is a gap.
    """
    several = itertools.chain.from_iterable(subscriptions.values())
    arrays = any(array_fields(schema_of(subscription.message).json_schema) for subscription in several)
    return ARRAY_QUEUE if arrays else RECEIVE_QUEUE


def _merged(
    inbox: deque[Frame],
    hand_over: HandOver,
    received: ReceivedOffsets,
    buffers: Mapping[str, ReorderBuffer],
    subscriptions: Mapping[str, list[Subscription]],
) -> list[Frame]:
    """Return what the successor has to take up, each message once: the predecessor's first, then its own."""
    count = len(inbox) - len(hand_over.inbox)
    frames = list(inbox)
    own, theirs = frames[:count], [frame for frame in frames[count:] if frame.topic in buffers]
    last = {name: (account.epoch, account.sequence) for name, account in hand_over.consumed.items()}
    later = [(frame.topic, (frame.epoch, frame.sequence)) for frame in theirs]
    for name, point in [*later, *received.items()]:
        last[name] = max(last.get(name, (-1, 0)), point)
    for name, buffer in buffers.items():
        buffer.continue_from(*last.get(name, (-1, 0)))
        buffer.unread = 0
    had = {(frame.topic, frame.epoch, frame.sequence) for frame in theirs}
    for frame in own:
        buffer = buffers[frame.topic]
        if buffer.is_ordered:
            is_new = (frame.epoch, frame.sequence) > last.get(frame.topic, (-1, 0))
        else:
            is_new = (frame.topic, frame.epoch, frame.sequence) not in had
            is_new = is_new and any(
                subscription.expects(frame) for subscription in subscriptions[frame.topic]
            )
        if is_new:
            theirs.append(frame)
    for frame in theirs:
        buffers[frame.topic].unread += frame.kind == Kind.DATA
    return theirs
