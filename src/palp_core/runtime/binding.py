"""Connect what a node class declares to live ends: outlets, inputs with their accounts, timers and alarms."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import msgspec

from palp_core.errors import SchemaMismatch
from palp_core.runtime.delivery import EdgeCounter
from palp_core.runtime.handover import HandOver
from palp_core.runtime.message import Message, decode
from palp_core.runtime.node import Declaration, Node
from palp_core.runtime.outlet import Outlet
from palp_core.runtime.ports import Alarm, Timer
from palp_core.runtime.schema import schema_of
from palp_core.runtime.spec import NodeSpec, topic
from palp_core.runtime.timers import AlarmEnd, TimerEnd
from palp_core.runtime.wire import Frame, Kind

__all__ = ["Bindings", "Input", "Owner"]

Guard = Callable[[str, Callable[..., Any]], Callable[..., Any]]


class Owner(Protocol):
    """The executor, as its ends see it."""

    node: Node
    publishing: bool

    def now_ns(self) -> int:
        """Time of the present handler."""


class Input:
    """One wired input: how to decode it, who handles it, what has arrived."""

    def __init__(self, source: str, message: type[Message], handle: Callable[[Any], None]) -> None:
        self.source = source
        self.message = message
        self.type_hash = schema_of(message).type_hash
        self.handle = handle
        self.counter = EdgeCounter()

    def accept(self, frame: Frame) -> Message | None:
        """Account for a frame and return its message, or None for a heartbeat or a repeat.

        Raises:
            SchemaMismatch: It carries another type, or bytes that are not this type.
        """
        if frame.kind != Kind.DATA:
            self.counter.heartbeat(frame.epoch, frame.sequence)
            return None
        if frame.type_hash != self.type_hash:
            raise SchemaMismatch(
                f"{frame.topic} carries another type than {self.message.__name__} "
                f"(hash {frame.type_hash:016x}, expected {self.type_hash:016x}): rebuild the older end"
            )
        message = decode(self.message, frame.payload)
        return message if self.counter.accept(frame.epoch, frame.sequence) else None


class Bindings:
    """The live ends of one node; puts them in place of the declarations on the instance.

    Args:
        declared: What the class declares.
        spec: The node's place in the graph.
        owner: Its executor.
        guard: Wraps a handler so that its failure is the node's.
        send: Takes each published frame.
    """

    def __init__(
        self, declared: Declaration, spec: NodeSpec, owner: Owner, guard: Guard, send: Callable[[bytes], None]
    ) -> None:
        self.outlets: dict[str, Outlet[Any]] = {}
        self.inputs: dict[str, list[Input]] = {}
        self.timers: dict[str, TimerEnd | AlarmEnd] = {}
        self._spec, self._owner, self._send = spec, owner, send
        handlers = {name: guard(name, handler) for name, handler in declared.handlers.items()}
        self._bind_topics(declared, handlers)
        self._bind_services(declared, handlers, guard)
        self._bind_timers(declared, handlers)

    def outlet(self, name: str, message: type[Message], depth: int) -> Outlet[Any]:
        """Add an output."""
        made: Outlet[Any] = Outlet(name, message, depth, self._spec.epoch, self._owner, self._send)
        self.outlets[name] = made
        return made

    def _wire(self, name: str, source: str, message: type[Message], handle: Callable[[Any], None]) -> None:
        self.inputs.setdefault(name, []).append(Input(source, message, handle))

    def _bind_topics(self, declared: Declaration, handlers: dict[str, Callable[..., Any]]) -> None:
        spec, ends = self._spec, self._owner.node.__dict__
        for name, pub in declared.pubs.items():
            ends[name] = self.outlet(topic(spec.name, name), pub.message, pub.qos.depth)
        for name, sub in declared.subs.items():
            if name in spec.inputs:
                self._wire(spec.inputs[name], f"input:{name}", sub.message, handlers[name])

    def _bind_services(
        self, declared: Declaration, handlers: dict[str, Callable[..., Any]], guard: Guard
    ) -> None:
        """A client's requests are a topic of its own; the replies to it are a topic of the server's."""
        spec, ends = self._spec, self._owner.node.__dict__
        for name, client in declared.clients.items():
            own = topic(spec.name, name)
            ends[name] = self.outlet(own, client.request, 10)
            if name in spec.inputs:
                self._wire(spec.inputs[name] + own, f"reply:{name}", client.reply, handlers[name])
        for name, service in declared.services.items():
            for client_topic in spec.requests.get(name, []):
                reply = self.outlet(topic(spec.name, name) + client_topic, service.reply, 10)
                answer = guard(name, _answer(declared.handlers[name], reply))
                self._wire(client_topic, f"call:{name}{client_topic}", service.request, answer)

    def _bind_timers(self, declared: Declaration, handlers: dict[str, Callable[..., Any]]) -> None:
        owner = self._owner
        for name in declared.handlers:
            if name in declared.timers:
                timer = declared.timers[name]
                self.timers[name] = TimerEnd(name, timer.hz, timer.running, owner, handlers[name])
            elif name in declared.alarms:
                self.timers[name] = AlarmEnd(name, owner, handlers[name])
            if isinstance(getattr(type(owner.node), name, None), Timer | Alarm):
                owner.node.__dict__[name] = self.timers[name]

    def sources(self) -> Iterator[str]:
        """Yield the name of everything that the node can consume."""
        for inputs in self.inputs.values():
            yield from (wired.source for wired in inputs)
        yield from (f"timer:{name}" for name in self.timers)

    @property
    def counters(self) -> dict[str, EdgeCounter]:
        """Account of every input topic."""
        return {name: inputs[0].counter for name, inputs in self.inputs.items()}

    def running_timers(self) -> dict[str, tuple[int, int | None]]:
        """Return the next tick of every periodic timer and when it is due (None: stopped)."""
        return {n: (end.k, end.due_ns) for n, end in self.timers.items() if isinstance(end, TimerEnd)}

    def set_alarms(self) -> dict[str, int]:
        """Return when every set alarm rings."""
        return {
            name: end.due_ns
            for name, end in self.timers.items()
            if isinstance(end, AlarmEnd) and end.due_ns is not None
        }

    def resume(self, hand_over: HandOver) -> None:
        """Continue a predecessor's timers, accounts and sequences."""
        for name, end in self.timers.items():
            if isinstance(end, TimerEnd):
                end.resume(hand_over.timers.get(name), hand_over.now_ns)
            else:
                end.resume(hand_over.alarms.get(name))
        for name, counter in hand_over.consumed.items():
            for wired in self.inputs.get(name, []):
                wired.counter = msgspec.structs.replace(counter)
        for name, out in self.outlets.items():
            out.resume(hand_over.epoch, hand_over.published.get(name, 0), hand_over.history.get(name, []))


def _answer(handler: Callable[..., Any], reply: Outlet[Any]) -> Callable[..., None]:
    @functools.wraps(handler)
    def answer(node: Node, request: Message) -> None:
        reply.publish(handler(node, request))

    return answer
