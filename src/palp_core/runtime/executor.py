"""Run one node: one handler at a time, timers in declaration order, then messages as they are given.

The executor knows nothing of sockets. Whoever drives it hands in frames and time and takes frames out, so
the same code runs a node in its own process, in composition and on a test bench.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import operator
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import GraphError, NodeError, PalpError, SchemaMismatch
from palp_core.runtime.builtin import Order
from palp_core.runtime.clock import Clock
from palp_core.runtime.delivery import EdgeCounter
from palp_core.runtime.handover import HandOver, adopt_state, rng_from_text, rng_to_text
from palp_core.runtime.lifecycle import Lifecycle, Transition, successor
from palp_core.runtime.message import Message, decode, decode_any, encode_any, schema_of
from palp_core.runtime.node import Node, Params, State, declaration_of
from palp_core.runtime.order import OrderLog
from palp_core.runtime.outlet import Outlet
from palp_core.runtime.ports import Alarm, Timer
from palp_core.runtime.spec import NodeSpec, topic
from palp_core.runtime.timers import AlarmEnd, TimerEnd
from palp_core.runtime.wire import Frame, Kind, parse

__all__ = ["Executor", "load_params"]

ORDER_PORT = "_order"
SLOWEST_HZ, FASTEST_HZ = 1e-9, 1e9  # the grid of ticks is in whole ns


def load_params(params_class: type[Params], values: Mapping[str, Any], where: str) -> Params:
    """Return validated parameters.

    Raises:
        GraphError: An unknown name, a wrong type or a value out of bounds.
    """
    try:
        return msgspec.convert(dict(values), params_class)
    except msgspec.ValidationError as error:
        raise GraphError(f"{where}: parameters: {error}") from error


class _Input:
    """One wired input: how to decode it, who handles it, what has arrived."""

    def __init__(self, source: str, message: type[Message], handle: Callable[[Any], None]) -> None:
        self.source = source
        self.message = message
        self.type_hash = schema_of(message).type_hash
        self.handle = handle
        self.counter = EdgeCounter()


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
        name_words = np.frombuffer(hashlib.blake2b(spec.name.encode(), digest_size=16).digest(), dtype="<u4")
        self.rng = np.random.default_rng([spec.seed, *name_words.tolist()])
        self.node = node_class(self)
        self.node.params = self._load(spec.params)
        self.node.state = self._first_state()
        self.outlets: dict[str, Outlet[Any]] = {}
        self._inputs: dict[str, list[_Input]] = {}
        self._timers: dict[str, TimerEnd | AlarmEnd] = {}
        self._bind(send)
        self._order_outlet: Outlet[Order] = Outlet(
            topic(self.name, ORDER_PORT), Order, 1, spec.epoch, self, send
        )
        self._order = OrderLog(
            [i.source for inputs in self._inputs.values() for i in inputs]
            + [f"timer:{name}" for name in self._timers]
            + ["parameters"]
        )

    def _load(self, values: Mapping[str, Any]) -> Params:
        params = load_params(self._declaration.params, values, self.name)
        for name, timer in self._declaration.timers.items():
            rate_hz = getattr(params, timer.hz)
            if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
                raise GraphError(
                    f"{self.name}: parameters: '{timer.hz}' is the rate of '{name}': {rate_hz:g} is no rate"
                )
        return params

    def _first_state(self) -> State:
        """Return the default state through its bytes, so that no two nodes share a default array."""
        state_class = self._declaration.state
        try:
            return decode_any(state_class, encode_any(state_class()), writable=True)
        except (SchemaMismatch, TypeError, ValueError) as error:
            raise GraphError(f"{self.name}: {state_class.__name__} cannot be handed over: {error}") from error

    def _bind(self, send: Callable[[bytes], None]) -> None:
        declared, ends = self._declaration, self.node.__dict__
        handlers = {name: self._guard(name, h) for name, h in declared.handlers.items()}

        def outlet(name: str, message: type[Message], depth: int) -> Outlet[Any]:
            made = Outlet(name, message, depth, self.spec.epoch, self, send)
            self.outlets[name] = made
            return made

        def wire(name: str, source: str, message: type[Message], handle: Callable[[Any], None]) -> None:
            self._inputs.setdefault(name, []).append(_Input(source, message, handle))

        for name, pub in declared.pubs.items():
            ends[name] = outlet(topic(self.name, name), pub.message, pub.qos.depth)
        for name, sub in declared.subs.items():
            if name in self.spec.inputs:
                wire(self.spec.inputs[name], f"input:{name}", sub.message, handlers[name])
        for name, client in declared.clients.items():
            own = topic(self.name, name)
            ends[name] = outlet(own, client.request, 10)
            if name in self.spec.inputs:
                wire(self.spec.inputs[name] + own, f"reply:{name}", client.reply, handlers[name])
        for name, service in declared.services.items():
            for client_topic in self.spec.requests.get(name, []):
                reply = outlet(topic(self.name, name) + client_topic, service.reply, 10)

                answer = _answer(declared.handlers[name], reply)
                wire(client_topic, f"call:{name}{client_topic}", service.request, self._guard(name, answer))
        for name in declared.handlers:
            if name in declared.timers:
                timer = declared.timers[name]
                self._timers[name] = TimerEnd(name, timer.hz, timer.running, self, handlers[name])
            elif name in declared.alarms:
                self._timers[name] = AlarmEnd(name, self, handlers[name])
            if isinstance(getattr(type(self.node), name, None), Timer | Alarm):
                ends[name] = self._timers[name]

    def _guard(self, port: str, handler: Callable[..., Any]) -> Callable[..., Any]:
        node, name = self.node, self.name

        def guarded(*arguments: Any) -> Any:
            try:
                return handler(node, *arguments)
            except (Exception, SystemExit) as error:
                self._fail(error)
                where = f"{handler.__name__} (handler of '{port}')"
                raise NodeError(name, f"{where} failed: {_words(error)}") from error

        return guarded

    def _fail(self, error: BaseException) -> None:
        self.log.error("failed", exc_info=error)
        reason = error if isinstance(error, Exception) else NodeError(self.name, _words(error))
        self.lifecycle = Lifecycle.FINALIZED
        hooks: list[Callable[[], None]] = [lambda: self.node.on_error(reason), self.node.on_deactivate]
        for hook in hooks:
            try:
                hook()
            except Exception:
                self.log.exception("a hook failed while the node was failing")
        self._publish_order(self._order.flush(self._now_ns))
        self.publishing = False

    # Context of the node

    def now_ns(self) -> int:
        """Return the time of the present handler."""
        return self._now_ns

    def finish(self, exit_code: int) -> None:
        """Note that the node's work is done."""
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
            for end in self._timers.values():
                end.begin(self._now_ns)
            self._put_state()
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.ACTIVE:
            self._hook("on_deactivate")
        self._hook(f"on_{transition.value}")
        if transition in (Transition.DEACTIVATE, Transition.SHUTDOWN):
            self._publish_order(self._order.flush(self._now_ns))
            self.publishing = False
        self.lifecycle = target

    def _hook(self, name: str) -> None:
        try:
            getattr(self.node, name)()
        except (Exception, SystemExit) as error:
            self._fail(error)
            raise NodeError(self.name, f"{name} failed: {_words(error)}") from error

    # Work

    def next_due_ns(self) -> int | None:
        """Return when the next timer or alarm is due, or None."""
        if self.lifecycle is not Lifecycle.ACTIVE:
            return None
        return min((end.due_ns for end in self._timers.values() if end.due_ns is not None), default=None)

    def run_timers(self) -> None:
        """Run every timer and alarm that is due, once each, in declaration order."""
        if self.lifecycle is not Lifecycle.ACTIVE:
            return
        self._now_ns = now_ns = self._clock.now_ns()
        for name, end in self._timers.items():
            if end.due_ns is not None and end.due_ns <= now_ns:
                self._note(f"timer:{name}", 0, end.tick())
                end.handle()

    def consume(self, raw: bytes) -> None:
        """Take one frame: account for it, decode it, run its handlers.

        A frame that is not what the edge carries is counted in ``rejected_count``, logged and dropped.

        Raises:
            NodeError: A handler failed.
        """
        if self.lifecycle is not Lifecycle.ACTIVE:
            self.inbox.append(raw)
            return
        try:
            frame = parse(raw)
            inputs = self._inputs.get(frame.topic)
            if not inputs:
                raise SchemaMismatch(f"topic {frame.topic} is not an input of {self.name}")
            accepted = self._account(frame, inputs)
        except SchemaMismatch as error:
            self._reject(error)
            return
        if accepted:
            self._now_ns = self._clock.now_ns()
            for wired, message in accepted:
                self._note(wired.source, frame.epoch, frame.sequence)
                wired.handle(message)

    def _account(self, frame: Frame, inputs: list[_Input]) -> list[tuple[_Input, Message]]:
        accepted = []
        for wired in inputs:
            if frame.kind != Kind.DATA:
                wired.counter.heartbeat(frame.epoch, frame.sequence)
                continue
            if frame.type_hash != wired.type_hash:
                raise SchemaMismatch(
                    f"{frame.topic} carries another type than {wired.message.__name__} "
                    f"(hash {frame.type_hash:016x}, expected {wired.type_hash:016x}): rebuild the older end"
                )
            message = decode(wired.message, frame.payload)
            if wired.counter.accept(frame.epoch, frame.sequence):
                accepted.append((wired, message))
        return accepted

    def _reject(self, error: SchemaMismatch) -> None:
        self.rejected_count += 1
        if self.rejected_count & (self.rejected_count - 1) == 0:  # the 1st, 2nd, 4th, 8th ...
            self.log.warning("rejected %d frame(s); the latest: %s", self.rejected_count, error)

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Replace the parameters as a whole, between two handlers.

        Raises:
            GraphError: A change does not fit; nothing is changed.
        """
        merged = {**msgspec.to_builtins(self.node.params), **changes}
        self.node.params = self._load(merged)
        self._now_ns = self._clock.now_ns()
        for end in self._timers.values():
            end.retime(self._now_ns)
        self._note("parameters", 0, 0)

    @property
    def counters(self) -> dict[str, EdgeCounter]:
        """Account of every input topic."""
        return {name: inputs[0].counter for name, inputs in self._inputs.items()}

    @property
    def input_topics(self) -> list[str]:
        """Every topic this node reads."""
        return list(self._inputs)

    # Order and hand-over

    def _note(self, source: str, epoch: int, sequence: int) -> None:
        if self._order.wants_state(self._now_ns):
            self._put_state()
        if self._order.note(source, epoch, sequence, self._now_ns):
            self._publish_order(self._order.flush(self._now_ns))

    def _put_state(self) -> None:
        version = type(self.node.state).version
        self._publish_order(self._order.put_state(version, self._state_bytes(), self._now_ns))

    def _state_bytes(self) -> bytes:
        try:
            return encode_any(self.node.state)
        except (SchemaMismatch, TypeError, ValueError, OverflowError) as error:
            self._fail(error)
            raise NodeError(self.name, f"its state cannot be written down: {error}") from error

    def _publish_order(self, batch: Order | None) -> None:
        if batch is not None:
            self._order_outlet.put(batch)

    def hand_over(self) -> HandOver:
        """Return everything a successor needs, at a handler boundary."""
        state = self.node.state
        every = {**self.outlets, self._order_outlet.topic: self._order_outlet}
        self._publish_order(self._order.flush(self._now_ns))
        return HandOver(
            node_class=_class_name(self.node),
            state_version=type(state).version,
            state=self._state_bytes(),
            epoch=self.epoch,
            now_ns=self._now_ns,
            inbox=list(self.inbox),
            consumed={name: msgspec.structs.replace(c) for name, c in self.counters.items()},
            published={name: o.sequence for name, o in every.items()},
            history={name: list(o.history) for name, o in self.outlets.items()},
            timers={n: (e.k, e.due_ns) for n, e in self._timers.items() if isinstance(e, TimerEnd)},
            alarms={
                n: e.due_ns
                for n, e in self._timers.items()
                if isinstance(e, AlarmEnd) and e.due_ns is not None
            },
            rng=rng_to_text(self.rng),
        )

    def take_over(self, hand_over: HandOver) -> None:
        """Continue where another executor stopped: state, sequences, timers, randomness, unread inbox.

        The node must be configured and inactive; it is active afterwards, without running ``on_activate``'s
        first publications again: the hook is not run.

        Raises:
            SchemaMismatch: The state does not fit this class.
            LifecycleError: The node is not inactive.
        """
        target = successor(self.lifecycle, Transition.ACTIVATE)
        self.node.state = adopt_state(self._declaration.state, _class_name(self.node), hand_over)
        self._now_ns = hand_over.now_ns
        self.rng = rng_from_text(hand_over.rng)
        self.epoch = hand_over.epoch
        self.publishing = True
        for name, end in self._timers.items():
            if isinstance(end, TimerEnd):
                end.resume(hand_over.timers.get(name), self._now_ns)
            else:
                end.resume(hand_over.alarms.get(name))
        for name, counter in hand_over.consumed.items():
            for wired in self._inputs.get(name, []):
                wired.counter = msgspec.structs.replace(counter)
        for name, out in {**self.outlets, self._order_outlet.topic: self._order_outlet}.items():
            out.resume(hand_over.epoch, hand_over.published.get(name, 0), hand_over.history.get(name, []))
        self.inbox.extend(hand_over.inbox)
        self.lifecycle = target
        self._put_state()

    def drain(self) -> None:
        """Consume what waits in the inbox."""
        while self.inbox and self.lifecycle is Lifecycle.ACTIVE:
            self.consume(self.inbox.popleft())


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, PalpError) else f"{type(error).__name__}: {error}"


def _answer(handler: Callable[..., Any], reply: Outlet[Any]) -> Callable[..., None]:
    @functools.wraps(handler)
    def answer(node: Node, request: Message) -> None:
        reply.publish(handler(node, request))

    return answer


def _class_name(node: Node) -> str:
    return f"{type(node).__module__}:{type(node).__qualname__}"
