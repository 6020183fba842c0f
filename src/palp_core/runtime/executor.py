"""Run one node: one handler at a time, timers in declaration order, then messages as they are given.

The executor knows nothing of sockets. Whoever drives it hands in frames and time and takes frames out, so
the same code runs a node in its own process, in composition and on a test bench.
"""

from __future__ import annotations

import logging
import operator
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from palp_core.errors import NodeError, SchemaMismatch, in_words
from palp_core.runtime.binding import Bindings
from palp_core.runtime.builtin import Order
from palp_core.runtime.clock import Clock
from palp_core.runtime.delivery import EdgeCounter
from palp_core.runtime.handover import HandOver, adopt_state, first_state
from palp_core.runtime.lifecycle import Lifecycle, Transition, successor
from palp_core.runtime.message import encode_any
from palp_core.runtime.node import Node, class_name, declaration_of
from palp_core.runtime.order import ACTIVATE, ORDER_PORT, PARAMETERS, OrderLog
from palp_core.runtime.outlet import Outlet
from palp_core.runtime.params import load_params
from palp_core.runtime.randomness import rng_from_text, rng_of, rng_to_text
from palp_core.runtime.spec import NodeSpec, topic
from palp_core.runtime.wire import parse

__all__ = ["Executor"]


class Executor:
    """One node between its driver and its handlers.

    Args:
        node_class: The class to run.
        spec: Its place in the graph.
        clock: The graph's clock.
        send: Takes each published frame.

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
        self.log = logging.getLogger(f"palp.{spec.name}")
        self.inbox: deque[bytes] = deque()
        self.rejected_count = 0
        self._clock = clock
        self._now_ns = 0
        self._declaration = declaration_of(node_class)
        self.rng = rng_of(spec.seed, spec.name)
        self.node = node_class(self)
        self.node.params = load_params(self._declaration, spec.params, self.name)
        self.node.state = first_state(self._declaration.state, self.name)
        self._ends = Bindings(self._declaration, spec, self, self._guard, send)
        self._order = OrderLog(
            self._ends.outlet(topic(self.name, ORDER_PORT), Order, 1),
            [ACTIVATE, *self._ends.sources(), PARAMETERS],
            lambda: encode_any(self._snapshot()),
        )

    def _guard(self, port: str, handler: Callable[..., Any]) -> Callable[..., Any]:
        node, name = self.node, self.name

        def guarded(*arguments: Any) -> Any:
            try:
                return handler(node, *arguments)
            except (Exception, SystemExit) as error:
                self._fail(error)
                where = f"{handler.__name__} (handler of '{port}')"
                raise NodeError(name, f"{where} failed: {in_words(error)}") from error

        return guarded

    def _fail(self, error: BaseException) -> None:
        self.log.error("failed", exc_info=error)
        reason = error if isinstance(error, Exception) else NodeError(self.name, in_words(error))
        self.lifecycle = Lifecycle.FINALIZED
        hooks: list[Callable[[], None]] = [lambda: self.node.on_error(reason), self.node.on_deactivate]
        for hook in hooks:
            try:
                hook()
            except (Exception, SystemExit):
                self.log.exception("a hook failed while the node was failing")
        self._order.flush(self._now_ns)
        self.publishing = False

    # Context of the node

    def now_ns(self) -> int:
        """Return the time of the present handler."""
        return self._now_ns

    def finish(self, exit_code: int) -> None:
        """End the node's work: timers stop, and whatever still arrives is dropped."""
        self.exit_code = operator.index(exit_code)

    # Lifecycle

    def transition(self, transition: Transition) -> None:
        """Run a lifecycle transition with its hook.

        Raises:
            LifecycleError: Not allowed from the present state.
            NodeError: The hook failed.
        """
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.FINALIZED:
            return
        target = successor(self.lifecycle, transition)
        self._now_ns = self._clock.now_ns()
        if transition is Transition.ACTIVATE:
            self.publishing = True
            for end in self._ends.timers.values():
                end.begin(self._now_ns)
            self._state_bytes()  # a state that cannot be handed over is found now, not at the first swap
            self._order.note(ACTIVATE, 0, 0, self._now_ns)
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.ACTIVE:
            self._hook("on_deactivate")
        self._hook(f"on_{transition.value}")
        if transition in (Transition.DEACTIVATE, Transition.SHUTDOWN):
            self._order.flush(self._now_ns)
            self.publishing = False
        self.lifecycle = target

    def _hook(self, name: str) -> None:
        try:
            getattr(self.node, name)()
        except (Exception, SystemExit) as error:
            self._fail(error)
            raise NodeError(self.name, f"{name} failed: {in_words(error)}") from error

    # Work

    def next_due_ns(self) -> int | None:
        """Return when the next timer or alarm is due, or None."""
        if self.lifecycle is not Lifecycle.ACTIVE or self.exit_code is not None:
            return None
        return min((end.due_ns for end in self._ends.timers.values() if end.due_ns is not None), default=None)

    def run_timers(self) -> None:
        """Run every timer and alarm that is due, once each, in declaration order."""
        if self.lifecycle is not Lifecycle.ACTIVE:
            return
        now_ns = self._clock.now_ns()
        for name, end in self._ends.timers.items():
            if end.due_ns is not None and end.due_ns <= now_ns and self.exit_code is None:
                self.ring(name)

    def ring(self, name: str) -> int:
        """Run one timer or alarm now, due or not; return its tick number."""
        end = self._ends.timers[name]
        self._now_ns = self._clock.now_ns()
        self._order.prepare(self._now_ns)
        k = end.tick()
        self._order.note(f"timer:{name}", 0, k, self._now_ns)
        end.handle()
        return k

    def consume(self, raw: bytes) -> None:
        """Take one frame: account for it, decode it, run its handlers.

        A frame that is not what the edge carries is counted in ``rejected_count``, logged and dropped.

        Raises:
            NodeError: A handler failed.
        """
        if self.lifecycle is not Lifecycle.ACTIVE:
            self.inbox.append(raw)
            return
        if self.exit_code is not None:
            return
        self._now_ns = self._clock.now_ns()
        self._order.prepare(self._now_ns)
        try:
            frame = parse(raw)
            inputs = self._ends.inputs.get(frame.topic)
            if not inputs:
                raise SchemaMismatch(f"topic {frame.topic} is not an input of {self.name}")
            messages = [(wired, wired.accept(frame)) for wired in inputs]
        except SchemaMismatch as error:
            self._reject(error)
            return
        for wired, message in messages:
            if message is not None:
                self._order.note(wired.source, frame.epoch, frame.sequence, self._now_ns)
                wired.handle(message)

    def _reject(self, error: SchemaMismatch) -> None:
        self.rejected_count += 1
        if self.rejected_count & (self.rejected_count - 1) == 0:  # the 1st, 2nd, 4th, 8th ...
            self.log.warning("rejected %d frame(s); the latest: %s", self.rejected_count, error)

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Replace the parameters as a whole, between two handlers.

        Raises:
            GraphError: A change does not fit; nothing is changed.
        """
        self._now_ns = self._clock.now_ns()
        self._order.prepare(self._now_ns)
        merged = {**msgspec.to_builtins(self.node.params), **changes}
        self.node.params = load_params(self._declaration, merged, self.name)
        for end in self._ends.timers.values():
            end.retime(self._now_ns)
        self._order.note_change(changes, self._now_ns)

    @property
    def outlets(self) -> dict[str, Outlet[Any]]:
        """Every output by topic."""
        return self._ends.outlets

    @property
    def counters(self) -> dict[str, EdgeCounter]:
        """Account of every input topic."""
        return self._ends.counters

    @property
    def topic_of_source(self) -> dict[str, str]:
        """Topic behind each input, reply or call that the node's order names."""
        return {wired.source: name for name, inputs in self._ends.inputs.items() for wired in inputs}

    # Hand-over

    def _state_bytes(self) -> bytes:
        try:
            return encode_any(self.node.state)
        except (SchemaMismatch, TypeError, ValueError, OverflowError) as error:
            self._fail(error)
            raise NodeError(self.name, f"its state cannot be written down: {error}") from error

    def _snapshot(self) -> HandOver:
        """Return the hand-over without inbox and histories."""
        return HandOver(
            node_class=class_name(type(self.node)),
            state_version=type(self.node.state).version,
            state=self._state_bytes(),
            params=msgspec.to_builtins(self.node.params),
            epoch=self.epoch,
            now_ns=self._now_ns,
            inbox=[],
            consumed={name: msgspec.structs.replace(c) for name, c in self.counters.items()},
            published={name: out.sequence for name, out in self.outlets.items()},
            history={},
            timers=self._ends.running_timers(),
            alarms=self._ends.set_alarms(),
            rng=rng_to_text(self.rng),
        )

    def hand_over(self) -> HandOver:
        """Return everything a successor needs, at a handler boundary."""
        self._order.flush(self._now_ns)
        histories = {name: list(out.history) for name, out in self.outlets.items() if out.history}
        return msgspec.structs.replace(self._snapshot(), inbox=list(self.inbox), history=histories)

    def take_over(self, hand_over: HandOver) -> None:
        """Continue where another executor stopped: state, sequences, timers, randomness, unread inbox.

        The node must be configured and inactive; it is active afterwards. ``on_resume`` is run instead of
        ``on_activate``. A predecessor of the same class hands its parameters over too, live changes included.

        Raises:
            SchemaMismatch: The state does not fit this class.
            LifecycleError: The node is not inactive.
            NodeError: The hook failed.
        """
        target = successor(self.lifecycle, Transition.ACTIVATE)
        own_class = class_name(type(self.node))
        state = adopt_state(self._declaration.state, own_class, hand_over)
        if hand_over.node_class == own_class:
            self.node.params = load_params(self._declaration, hand_over.params, self.name)
        self.node.state = state
        self._now_ns = hand_over.now_ns
        self.rng = rng_from_text(hand_over.rng)
        self.epoch = hand_over.epoch
        self.publishing = True
        self._ends.resume(hand_over)
        self._hook("on_resume")
        self.inbox.extend(hand_over.inbox)
        self.lifecycle = target
        self._order.begin(self._now_ns)

    def drain(self) -> None:
        """Consume what waits in the inbox."""
        while self.inbox and self.lifecycle is Lifecycle.ACTIVE:
            self.consume(self.inbox.popleft())
