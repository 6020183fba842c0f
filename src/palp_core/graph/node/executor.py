"""Run one node: one handler at a time, timers in declaration order, then messages as they are given.

The executor knows nothing of sockets. Whoever drives it hands in frames and time and takes frames out, so
the same code runs a node in its own process, in composition and on a test bench.
"""

import logging
import operator
from collections import deque
from collections.abc import Callable
from typing import Any

from palp_core.errors import NodeError, SchemaMismatch, in_words
from palp_core.graph.clock import Clock
from palp_core.graph.log_format import ENDING
from palp_core.graph.messages.builtin import NodeEvent, Order
from palp_core.graph.messages.frame import Frame, parse
from palp_core.graph.messages.message import encode_any
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.bindings import Bindings
from palp_core.graph.node.event_publisher import EVENTS_PORT, EventPublisher
from palp_core.graph.node.handover import first_state
from palp_core.graph.node.journal import ORDER_PORT, Journal
from palp_core.graph.node.lifecycle import Lifecycle, LifecycleHooks, Transition, successor
from palp_core.graph.node.node import Node, declaration_of
from palp_core.graph.node.params import load_params
from palp_core.graph.node.qos_events import EventEnd
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.node.succession import Succession
from palp_core.graph.rng import rng_of


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
        swaps: Every time the node has changed hands.
        succession: Its change of hands.

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
        self.swaps: list[dict[str, Any]] = []
        self.log = logging.getLogger(f"palp.{spec.name}")
        self.inbox: deque[Frame] = deque()
        self.resend: Callable[[bytes], None] = lambda _: None
        node_class = node_class.shaped(spec.name, spec.params)
        self.declaration = declaration_of(node_class)
        self._clock = clock
        self._now_ns = 0
        self.rng = rng_of(spec.seed, spec.name)
        self.node = node_class(self)
        self.node.params = load_params(self.declaration, spec.params, self.name)
        self.node.state = first_state(self.declaration.state, self.name)
        self.failing = Failing(self)
        self.succession = Succession(self)
        self.ends = Bindings(self.declaration, spec, self, self.failing.guard, send)
        told = self.ends.publisher(topic(self.name, EVENTS_PORT), NodeEvent, Qos(depth=100))
        self.events = EventPublisher(told, self.log, self)
        self.journal = Journal(
            self.ends.publisher(topic(self.name, ORDER_PORT), Order, Qos(depth=1)),
            self.ends.sources(),
            lambda: encode_any(self.succession.snapshot()),
        )
        for subscriptions in self.ends.subscriptions.values():
            for subscription in subscriptions:
                subscription.index = self.journal.index[subscription.source]

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
        self.succession.resume()
        target = successor(self.lifecycle, transition)
        self._now_ns = self._clock.now_ns()
        if transition is Transition.ACTIVATE:
            self.publishing = True
            self.ends.activate(self._now_ns)
            self.succession.state_bytes()  # one that cannot be handed over is found now, not at a swap
        noted = self.journal.note_transition(transition, self._now_ns)
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.ACTIVE:
            self.failing.hook("on_deactivate")
        self.failing.hook(f"on_{transition.value}")
        if transition in (Transition.DEACTIVATE, Transition.SHUTDOWN):
            if self.lifecycle is Lifecycle.ACTIVE:
                self.ends.abandon_goals(f"{self.name} was deactivated")
            self.journal.flush(self._now_ns)
            self.publishing = False
        before, self.lifecycle = self.lifecycle, target
        if noted:
            data = {"transition": transition.value, "from": before.value, "to": target.value}
            self.events.publish("transition", f"{before.value} -> {target.value}", data)

    def next_due_ns(self) -> int | None:
        """Return when the next timer, alarm or event is due, or None."""
        if self.lifecycle is not Lifecycle.ACTIVE or self.exit_code is not None:
            return None
        soonest = None
        for end in self.ends.timers.values():  # a generator would cost more than what it goes through
            due_ns = end.due_ns
            if due_ns is not None and (soonest is None or due_ns < soonest):
                soonest = due_ns
        return soonest

    def run_timers(self) -> None:
        """Run everything that is due, once each, in declaration order."""
        if self.lifecycle is not Lifecycle.ACTIVE:
            return
        now_ns = self._clock.now_ns()
        for name, end in self.ends.timers.items():
            due_ns = end.due_ns
            if due_ns is not None and due_ns <= now_ns and self.exit_code is None:
                self.run_timer(name)

    def run_timer(self, name: str, recorded: int | None = None) -> int:
        """Run one timer, alarm or event now, due or not; return its tick number or total count.

        Args:
            name: Which one.
            recorded: In a replay, the total count that the event had.
        """
        end = self.ends.timers[name]
        self._now_ns = self._clock.now_ns()
        self.journal.snapshot_if_due(self._now_ns)
        k = end.tick()
        if recorded is not None and isinstance(end, EventEnd):
            end.recall(recorded)
            k = recorded
        self.journal.note(f"timer:{name}", 0, k, self._now_ns)
        end.handle()
        return k

    def consume(self, raw: bytes | Frame) -> None:
        """Take one frame; one that comes before the node is active waits in the inbox.

        Raises:
            NodeError: A handler failed.
        """
        try:
            frame = raw if isinstance(raw, Frame) else parse(raw)
        except SchemaMismatch as error:
            self.events.reject(error)
            return
        if self.lifecycle is not Lifecycle.ACTIVE:
            self.inbox.append(frame)
            return
        if self.exit_code is not None:
            return
        subscriptions = self.ends.subscriptions.get(frame.topic)
        if not subscriptions:
            self.events.reject(SchemaMismatch(f"topic {frame.topic} is not an input of {self.name}"))
            return
        now_ns = self._clock.now_ns()
        for subscription in subscriptions:
            if not self.deliver(subscription, now_ns, *frame[1:]):
                return  # another subscription to the topic would say the same of it

    def deliver(
        self,
        subscription: Subscription,
        now_ns: int,
        kind: int,
        epoch: int,
        sequence: int,
        stamp_ns: int,
        type_hash: int,
        payload: memoryview,
    ) -> bool:
        """Account for a message that is due at an active node, write it down and hand it to its handler.

        Every message comes this way, in lockstep, on the wall clock and on a test bench. One that is not what
        the edge carries is counted in ``rejected_count``, logged and dropped.

        Returns:
            False if the message was rejected.

        Raises:
            NodeError: The handler failed.
        """
        self._now_ns = now_ns
        journal = self.journal
        if now_ns >= journal.next_snapshot_ns:
            journal.take_snapshot(now_ns)
        try:
            message = subscription.accept(kind, epoch, sequence, stamp_ns, type_hash, payload, now_ns)
        except SchemaMismatch as error:
            place = f"topic {subscription.topic}, input '{subscription.port}'"
            self.events.reject(SchemaMismatch(f"{place}: {error}; mend what its publisher sends"))
            return False
        if message is not None:
            journal.note_index(subscription.index, epoch, sequence, now_ns)
            subscription.last = (now_ns, message)
            try:
                subscription.handler(self.node, message)
            except BaseException as error:
                raise self.failing.failed(subscription.port, subscription.handler.__name__, error) from error
        return True

    def begin_command(self) -> None:
        """Give a command from outside, between two handlers, the present time and a place in the order."""
        self._now_ns = self._clock.now_ns()
        self.journal.snapshot_if_due(self._now_ns)


class Failing:
    """Turns whatever a node's code raises into the node's failure.

    Args:
        executor: The node's.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def guard(self, port: str, handler: Callable[..., Any]) -> Callable[..., Any]:
        """Return a handler, called without its node, whose failure is the node's."""
        node = self._executor.node

        def guarded(*arguments: Any) -> Any:
            try:
                return handler(node, *arguments)
            except BaseException as error:
                raise self.failed(port, handler.__name__, error) from error

        return guarded

    def hook(self, name: str) -> None:
        """Run a lifecycle hook.

        Raises:
            NodeError: It failed.
        """
        hooks: LifecycleHooks = self._executor.node
        try:
            getattr(hooks, name)()
        except BaseException as error:
            text = f"{name} failed: {in_words(error)}"
            self.fail(error, text)
            raise NodeError(self._executor.name, text) from error

    def failed(self, port: str, handler: str, error: BaseException) -> NodeError:
        """Fail, because a handler did; return what to raise."""
        text = f"{handler} (handler of '{port}') failed: {in_words(error)}"
        self.fail(error, text)
        return NodeError(self._executor.name, text)

    def fail(self, error: BaseException, text: str) -> None:
        """Finalize the node, its safe state reached; its log says what has failed, with the trace."""
        if isinstance(error, KeyboardInterrupt):  # it is the user's
            raise error
        executor = self._executor
        executor.log.critical("%s", text, exc_info=error, extra=ENDING)
        reason = error if isinstance(error, Exception) else NodeError(executor.name, in_words(error))
        executor.lifecycle = Lifecycle.FINALIZED
        hooks: list[Callable[[], None]] = [
            lambda: executor.node.on_error(reason),
            executor.node.on_deactivate,
            lambda: executor.ends.abandon_goals(f"{executor.name} failed: {text}"),
        ]
        for hook in hooks:
            try:
                hook()
            except KeyboardInterrupt:
                raise
            except BaseException:
                executor.log.exception("a hook failed while the node was failing")
        executor.journal.flush(executor.now_ns())
        executor.publishing = False
