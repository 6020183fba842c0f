"""What a node declares: inputs, outputs, services, timers, and which method handles which.

Ports are class attributes. On an instance, the executor puts the live end in their place, so that
``self.belief.publish(...)`` is typed by the declaration.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, overload

from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.qos_events import QosEvent

if TYPE_CHECKING:
    from palp_core.graph.actions.client import WrappedResult
    from palp_core.graph.node.action_ports import ActionClient

M = TypeVar("M", bound=Message)
Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)
Sent = TypeVar("Sent", bound=Message, contravariant=True)
Handler = TypeVar("Handler", bound=Callable[..., Any])

HANDLES = "__palp_handles__"
HANDLES_EVENTS = "__palp_handles_events__"


class Port:
    """Base of all declarations; knows its attribute name."""

    name: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name


class Sub(Port, Generic[M]):
    """An input. Every message is handed to the method marked ``@on(port)``.

    Args:
        message: What it takes.
        qos: What it requests.
        optional: It may stay unwired, and its publisher may be replaced by a class that does not publish it.
        lasting: It may stay unwired; where it is wired, its publisher's successors must publish it, too.
    """

    def __init__(
        self, message: type[M], *, qos: Qos | None = None, optional: bool = False, lasting: bool = False
    ) -> None:
        self.message = message
        self.qos = qos or Qos()
        self.optional = optional or lasting
        self.lasting = lasting


class Publisher(Protocol[Sent]):
    """The live end of a :class:`Pub`."""

    def publish(self, message: Sent) -> None:
        """Send a message to every reader; its stamp is the node's time.

        Raises:
            PublishTimeout: A reader made no room in time, where the edge's history is ``keep_all``.
        """

    def idle(self) -> None:
        """Declare that nothing is due until the next message: readers' deadlines are suspended until then."""


class Pub(Port, Generic[M]):
    """An output: the topic ``/<node>/<port>``.

    A port named ``truth`` carries what a real rig cannot know; graphs allow it to simulations and records
    only.
    """

    def __init__(self, message: type[M], *, qos: Qos | None = None) -> None:
        self.message = message
        self.qos = qos or Qos()

    @overload
    def __get__(self, instance: None, owner: type) -> Pub[M]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Publisher[M]: ...
    def __get__(self, instance: object | None, owner: type) -> Pub[M] | Publisher[M]:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} publishes only while an executor runs the node")


class Srv(Port, Generic[Request, Reply]):
    """A service; the method marked ``@serve(port)`` answers each request."""

    def __init__(self, request: type[Request], reply: type[Reply]) -> None:
        self.request = request
        self.reply = reply


class Caller(Protocol[Sent]):
    """The live end of a :class:`Client`."""

    def call(self, request: Sent) -> None:
        """Send a request and return at once; the reply arrives at ``@on(client)``."""


class Client(Port, Generic[Request, Reply]):
    """The asking end of a service; wired in the launch file like an input.

    Args:
        request: What it sends.
        reply: What it gets.
        timeout_ms: How long one try may take on the node's clock.
        retries: How often a request is sent again. The server does what it asks once: it knows a request it
            has seen by its sequence and repeats its reply. After the last try the method marked
            ``@on_event(client)`` gets a ``call_timeout``.
    """

    def __init__(
        self, request: type[Request], reply: type[Reply], *, timeout_ms: float = 1000.0, retries: int = 2
    ) -> None:
        self.request = request
        self.reply = reply
        self.timeout_ms = timeout_ms
        self.retries = retries

    @overload
    def __get__(self, instance: None, owner: type) -> Client[Request, Reply]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Caller[Request]: ...
    def __get__(self, instance: object | None, owner: type) -> Client[Request, Reply] | Caller[Request]:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} calls only while an executor runs the node")


class RunningTimer(Protocol):
    """The live end of a :class:`Timer`."""

    def start(self) -> None:
        """Tick from the next grid instant on; no effect if it already ticks."""

    def stop(self) -> None:
        """Tick no more."""


class Timer(Port):
    """A periodic timer that the node starts and stops; tick k is due at round(k 1e9 / rate)."""

    def __init__(self, hz: str, *, running: bool = False) -> None:
        self.hz = hz
        self.running = running

    @overload
    def __get__(self, instance: None, owner: type) -> Timer: ...
    @overload
    def __get__(self, instance: object, owner: type) -> RunningTimer: ...
    def __get__(self, instance: object | None, owner: type) -> Timer | RunningTimer:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} ticks only while an executor runs the node")


class SetAlarm(Protocol):
    """The live end of an :class:`Alarm`."""

    def set(self, due_ns: int) -> None:
        """Ring once at that time on the node's clock (at once if it is past); replaces an earlier setting."""

    def clear(self) -> None:
        """Do not ring."""


class Alarm(Port):
    """A one-shot timer that the node sets."""

    @overload
    def __get__(self, instance: None, owner: type) -> Alarm: ...
    @overload
    def __get__(self, instance: object, owner: type) -> SetAlarm: ...
    def __get__(self, instance: object | None, owner: type) -> Alarm | SetAlarm:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} rings only while an executor runs the node")


@overload
def on(port: Sub[M]) -> Callable[[Callable[[Any, M], None]], Callable[[Any, M], None]]: ...
@overload
def on(
    port: Client[Request, Reply],
) -> Callable[[Callable[[Any, Reply], None]], Callable[[Any, Reply], None]]: ...
@overload
def on(
    port: ActionClient[Any, Any, Reply],
) -> Callable[[Callable[[Any, WrappedResult[Reply]], None]], Callable[[Any, WrappedResult[Reply]], None]]: ...
@overload
def on(port: Timer | Alarm) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]: ...
def on(port: Port) -> Callable[[Handler], Handler]:
    """Mark the method that handles a port's messages, a client's replies or results, or a timer's ticks."""
    return _mark(port)


def on_event(
    port: Sub[Any] | Pub[Any] | Client[Any, Any],
) -> Callable[[Callable[[Any, QosEvent], None]], Callable[[Any, QosEvent], None]]:
    """Mark the method that is told when an edge does not keep its promises, or a call is not answered.

    Of an output: when readers have lost messages for good.
    """

    def mark(handler: Handler) -> Handler:
        handler.__dict__[HANDLES_EVENTS] = port
        return handler

    return mark


def serve(
    port: Srv[Request, Reply],
) -> Callable[[Callable[[Any, Request], Reply]], Callable[[Any, Request], Reply]]:
    """Mark the method that answers a service."""
    return _mark(port)


def every(hz: str) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Mark a method to be run at the rate that the named parameter states in Hz."""
    return _mark(Timer(hz, running=True))


def _mark(port: Port) -> Callable[[Handler], Handler]:
    def mark(handler: Handler) -> Handler:
        if isinstance(port, Timer) and not port.name:
            port.name = handler.__name__
        handler.__dict__[HANDLES] = port
        return handler

    return mark
