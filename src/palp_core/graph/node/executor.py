"""Run one node: one handler at a time, timers in declaration order, then messages as they are given.

The executor knows nothing of sockets. Whoever drives it hands in frames and time and takes frames out, so
the same code runs a node in its own process, in composition and on a test bench.
"""

from __future__ import annotations

import logging
import operator
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from palp_core.errors import NodeError, SchemaMismatch
from palp_core.graph.clock import Clock
from palp_core.graph.messages.builtin import NodeEvent, Order
from palp_core.graph.messages.frame import Frame, parse
from palp_core.graph.messages.message import DECODE_ERRORS, encode_any
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.bindings import Bindings
from palp_core.graph.node.event_publisher import EVENTS_PORT, EventPublisher
from palp_core.graph.node.failing import Failing
from palp_core.graph.node.handover import HandOver, first_state
from palp_core.graph.node.journal import ORDER_PORT, Journal
from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor
from palp_core.graph.node.node import Node, declaration_of
from palp_core.graph.node.params import load_params
from palp_core.graph.node.qos_events import EventEnd
from palp_core.graph.node.rng import rng_of
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.node.succession import hand_over_of, leave, snapshot, take_over


class Executor:
    """One node between its driver and its handlers.

    Args:
        node_class: The class to run.
        spec: Its place in the graph.
        clock: The graph's clock.
        send: Takes each published frame.

    Attributes:
        inbox: Frames that wait for the node to be active.
        resend: Takes a frame that is sent again.
        send_pieces: Takes the topic and the pieces of a large message; None: it is sent whole.
        swaps: Every time the node has changed hands.
        paused: At a boundary, until it is clear who goes on.

    Raises:
        GraphError: The parameters do not fit the class.
    """

    def __init__(
        self, node_class: type[Node], spec: NodeSpec, clock: Clock, send: Callable[[bytes], None]
    ) -> None:
        self.spec = spec
        self.name = spec.name
        self.lifecycle = Lifecycle.UNCONFIGURED
        self.exit_code: int | None = None
        self.epoch = spec.epoch
        self.publishing = False
        self.paused = False
        self.swaps: list[dict[str, Any]] = []
        self.log = logging.getLogger(f"palp.{spec.name}")
        self.inbox: deque[Frame] = deque()
        self.resend: Callable[[bytes], None] = lambda _: None
        self.send_pieces: Callable[[bytes, bytes, memoryview, bytes], None] | None = None
        node_class = node_class.shaped(spec.name, spec.params)
        self.declaration = declaration_of(node_class)
        self._clock = clock
        self._now_ns = 0
        self.rng = rng_of(spec.seed, spec.name)
        self.node = node_class(self)
        self.node.params = load_params(self.declaration, spec.params, self.name)
        self.node.state = first_state(self.declaration.state, self.name)
        self.failing = Failing(self)
        self.ends = Bindings(self.declaration, spec, self, self.failing.guard, send)
        told = self.ends.publisher(topic(self.name, EVENTS_PORT), NodeEvent, Qos(depth=100))
        self.events = EventPublisher(told, self.log, self)
        self.order = Journal(
            self.ends.publisher(topic(self.name, ORDER_PORT), Order, Qos(depth=1)),
            self.ends.sources(),
            lambda: encode_any(snapshot(self)),
        )
        for inputs in self.ends.inputs.values():
            for wired in inputs:
                wired.index = self.order.index_of(wired.source)

    def now_ns(self) -> int:
        """Return the time of the present handler."""
        return self._now_ns

    def set_time(self, now_ns: int) -> None:
        """Set the time of the present handler."""
        self._now_ns = now_ns

    def finish(self, exit_code: int) -> None:
        """End the node's work: timers stop, and whatever still arrives is dropped."""
        self.exit_code = operator.index(exit_code)

    def transition(self, transition: Transition) -> None:
        """Run a lifecycle transition with its hook.

        Raises:
            LifecycleError: Not allowed from the present state.
            NodeError: The hook failed.
        """
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.FINALIZED:
            return
        self.resume()
        target = successor(self.lifecycle, transition)
        self._now_ns = self._clock.now_ns()
        if transition is Transition.ACTIVATE:
            self.publishing = True
            for end in self.ends.timers.values():
                end.begin(self._now_ns)
            self.state_bytes()  # a state that cannot be handed over is found now, not at the first swap
        noted = self.order.note_transition(transition, self._now_ns)
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.ACTIVE:
            self.failing.hook("on_deactivate")
        self.failing.hook(f"on_{transition.value}")
        if transition in (Transition.DEACTIVATE, Transition.SHUTDOWN):
            self.order.flush(self._now_ns)
            self.publishing = False
        before, self.lifecycle = self.lifecycle, target
        if noted:
            data = {"transition": transition.value, "from": before.value, "to": target.value}
            self.events.say("transition", f"{before.value} -> {target.value}", data)

    def next_due_ns(self) -> int | None:
        """Return when the next timer, alarm or event is due, or None."""
        if self.lifecycle is not Lifecycle.ACTIVE or self.exit_code is not None:
            return None
        return min(
            (due for end in self.ends.timers.values() if (due := end.due_ns) is not None), default=None
        )

    def run_timers(self) -> None:
        """Run everything that is due, once each, in declaration order."""
        if self.lifecycle is not Lifecycle.ACTIVE:
            return
        now_ns = self._clock.now_ns()
        for name, end in self.ends.timers.items():
            due_ns = end.due_ns
            if due_ns is not None and due_ns <= now_ns and self.exit_code is None:
                self.ring(name)

    def ring(self, name: str, recorded: int | None = None) -> int:
        """Run one timer, alarm or event now, due or not; return its tick number or total count.

        Args:
            name: Which one.
            recorded: In a replay, the total count that the event had.
        """
        end = self.ends.timers[name]
        self._now_ns = self._clock.now_ns()
        self.order.prepare(self._now_ns)
        k = end.tick()
        if recorded is not None and isinstance(end, EventEnd):
            end.recall(recorded)
            k = recorded
        self.order.note(f"timer:{name}", 0, k, self._now_ns)
        end.handle()
        return k

    def consume(self, raw: bytes | Frame) -> None:
        """Take one frame: account for it, decode it, run its handlers.

        A frame that is not what the edge carries is counted in ``rejected_count``, logged and dropped.

        Raises:
            NodeError: A handler failed.
        """
        try:
            frame = raw if isinstance(raw, Frame) else parse(raw)
            if self.lifecycle is not Lifecycle.ACTIVE:
                self.inbox.append(frame)
                return
            if self.exit_code is not None:
                return
            self._now_ns = self._clock.now_ns()
            self.order.prepare(self._now_ns)
            inputs = self.ends.inputs.get(frame.topic)
            if not inputs:
                raise SchemaMismatch(f"topic {frame.topic} is not an input of {self.name}")
            messages = [(wired, wired.accept(frame, self._now_ns)) for wired in inputs]
        except SchemaMismatch as error:
            self.events.reject(error)
            return
        for wired, message in messages:
            if message is not None:
                self.order.note(wired.source, frame.epoch, frame.sequence, self._now_ns)
                wired.handle(message)

    def take(self, wired: Subscription, epoch: int, sequence: int, payload: memoryview, now_ns: int) -> None:
        """Consume the next message of an edge on which nothing is missing: the short way of :meth:`consume`.

        What can wait until the handler has seen the message waits.

        Raises:
            NodeError: A handler failed.
        """
        if now_ns >= self.order.next_snapshot_ns:
            self.order.begin(now_ns)
        try:
            message = wired.decode(payload)
            if wired.check is not None:
                wired.check(message)
        except DECODE_ERRORS as error:
            self.events.reject(SchemaMismatch(f"not a {wired.message.__name__}: {error}"))
            return
        self._now_ns = now_ns
        try:
            wired.handler(self.node, message)
        except (Exception, SystemExit) as error:
            raise self.failing.failed(wired.port, wired.handler.__name__, error) from error
        finally:
            self.order.note_index(wired.index, epoch, sequence, now_ns)
            counter = wired.account
            if sequence == counter.sequence + 1:
                counter.sequence = sequence
                counter.received += 1
            else:
                wired.skip_to(sequence, now_ns)

    def begin_command(self) -> None:
        """Give a command from outside, between two handlers, the present time and a place in the order."""
        self._now_ns = self._clock.now_ns()
        self.order.prepare(self._now_ns)

    # Hand-over

    def state_bytes(self) -> bytes:
        """Return the encoded state.

        Raises:
            NodeError: It holds what cannot be written down; the node has failed.
        """
        try:
            return encode_any(self.node.state)
        except (SchemaMismatch, TypeError, ValueError, OverflowError) as error:
            self.failing.fail(error)
            raise NodeError(self.name, f"its state cannot be written down: {error}") from error

    def hand_over(self) -> HandOver:
        """Return everything a successor needs, at a handler boundary."""
        self.order.flush(self._now_ns)
        return hand_over_of(self)

    @property
    def is_active(self) -> bool:
        """Whether the node is at work, or paused in it."""
        return self.lifecycle is Lifecycle.ACTIVE or self.paused

    def pause(self) -> None:
        """Take up and publish nothing more, at a handler boundary; no hook runs."""
        if self.lifecycle is Lifecycle.ACTIVE:
            self.paused, self.publishing, self.lifecycle = True, False, Lifecycle.INACTIVE

    def resume(self) -> None:
        """Go on after :meth:`pause`."""
        if self.paused:
            self.paused, self.publishing, self.lifecycle = False, True, Lifecycle.ACTIVE

    def leave(self) -> None:
        """End a node that another process goes on with: the hooks of the safe end run and publish nothing."""
        leave(self)

    def take_over(self, hand_over: HandOver, changes: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Continue where another executor stopped: state, sequences, timers, randomness, unread inbox.

        The node must be configured and inactive; afterwards it is what its predecessor was. ``on_resume`` is
        run instead of ``on_activate``. A predecessor of the same class hands its parameters over too, live
        changes included; ``changes`` are those that are to be others.

        Raises:
            SchemaMismatch, GraphError: The state or the parameters do not fit this class.
            LifecycleError: The node is not inactive.
            NodeError: The hook failed.
        """
        take_over(self, hand_over, changes)
