"""What a node declares: inputs, outputs, services, timers, actions, and which method handles which.

Ports are class attributes. On an instance, the executor puts the live end in their place, so that
``self.belief.publish(...)`` is typed by the declaration. A handler is a plain function and ends soon, that of
an action, too: what a goal has reached is in the node's state. So a node may be swapped, written down and
replayed in the middle of a goal.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Generic, Literal, NamedTuple, Self, TypeVar, overload

from msgspec.structs import replace

from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node import action_messages as wire
from palp_core.graph.node.action_client import ActionClientEnd, WrappedResult
from palp_core.graph.node.action_server import ActionServerEnd, GoalHandle, WhenBusy
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import QosEvent
from palp_core.graph.node.service_client import ClientEnd
from palp_core.graph.node.spec import part
from palp_core.graph.node.timers import AlarmEnd, TimerEnd

M = TypeVar("M", bound=Message)
Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)
Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Result = TypeVar("Result", bound=Message)
End = TypeVar("End")
Handler = TypeVar("Handler", bound=Callable[..., Any])

PortKind = Literal["sub", "pub", "srv", "client", "act", "action_client", "timer", "alarm"]
SERVICE = Qos(depth=100)
STATUS = Qos(durability="transient_local", depth=10)
ACTION_CALLS = ("send_goal", "cancel_goal", "get_result")


class Port:
    """Base of all declarations; knows its attribute name.

    Attributes:
        kind: What it is.
        messages: Its message; of a service request and reply; of an action goal, feedback and result.
    """

    name: str = ""
    kind: ClassVar[PortKind]
    messages: tuple[type[Message], ...] = ()

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name


class LivePort(Port, Generic[End]):
    """A port that stands for its live end on an instance."""

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type) -> End: ...
    def __get__(self, instance: object | None, owner: type) -> Any:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} works only while an executor runs the node")


class Sub(Port, Generic[M]):
    """An input. Every message is handed to the method marked ``@on(port)``.

    Args:
        message: What it takes.
        qos: What it requests.
        optional: It may stay unwired, and its publisher may be replaced by a class that does not publish it.
        lasting: It may stay unwired; where it is wired, its publisher's successors must publish it, too.
    """

    kind = "sub"

    def __init__(
        self, message: type[M], *, qos: Qos | None = None, optional: bool = False, lasting: bool = False
    ) -> None:
        self.message = message
        self.messages = (message,)
        self.qos = qos or Qos()
        self.optional = optional or lasting
        self.lasting = lasting


class Pub(LivePort[PublisherEnd[M]], Generic[M]):
    """An output: the topic ``/<node>/<port>``.

    A port named ``truth`` carries what a real rig cannot know; graphs allow it to simulations and records
    only.
    """

    kind = "pub"

    def __init__(self, message: type[M], *, qos: Qos | None = None) -> None:
        self.message = message
        self.messages = (message,)
        self.qos = qos or Qos()


class Srv(Port, Generic[Request, Reply]):
    """A service; the method marked ``@serve(port)`` answers each request."""

    kind = "srv"

    def __init__(self, request: type[Request], reply: type[Reply]) -> None:
        self.request, self.reply = self.messages = request, reply


class Client(LivePort[ClientEnd[Request]], Generic[Request, Reply]):
    """The client of a service. The launch file wires it like an input.

    Args:
        request: What it sends.
        reply: What it gets.
        timeout_ms: How long one try may take on the node's clock.
        retries: How often a request is sent again. The server does what it asks once: it knows a request it
            has seen by its sequence and repeats its reply. After the last try the method marked
            ``@on_event(client)`` gets a ``call_timeout``.
    """

    kind = "client"

    def __init__(
        self, request: type[Request], reply: type[Reply], *, timeout_ms: float = 1000.0, retries: int = 2
    ) -> None:
        self.request, self.reply = self.messages = request, reply
        self.timeout_ms = timeout_ms
        self.retries = retries


class Timer(LivePort[TimerEnd]):
    """A periodic timer that the node starts and stops; tick k is due at round(k 1e9 / rate)."""

    kind = "timer"

    def __init__(self, hz: str, *, running: bool = False) -> None:
        self.hz = hz
        self.running = running


class Alarm(LivePort[AlarmEnd]):
    """A one-shot timer that the node sets."""

    kind = "alarm"


class Act(LivePort[ActionServerEnd[Goal, Feedback, Result]], Generic[Goal, Feedback, Result]):
    """An action that this node serves; the method marked ``@execute(port)`` works on each goal.

    Args:
        goal: What is asked for.
        feedback: What is published on the way.
        result: What is returned at the end.
        when_busy: What becomes of a goal that comes while another one is not done: ``reject``; ``queue``: it
            waits its turn; ``preempt``: it waits while the others are canceled; ``parallel``: it begins.
        qos: Of the feedback.
    """

    kind = "act"

    def __init__(
        self,
        goal: type[Goal],
        feedback: type[Feedback],
        result: type[Result],
        *,
        when_busy: WhenBusy = "reject",
        qos: Qos | None = None,
    ) -> None:
        self.messages = goal, feedback, result
        self.types = wire.action_types(goal, feedback, result)
        self.when_busy: WhenBusy = when_busy
        self.qos = qos or Qos()


class ActionClient(LivePort[ActionClientEnd[Goal]], Generic[Goal, Feedback, Result]):
    """The client of an action. One key of the launch file wires all of it.

    The method marked ``@on(client)`` gets a ``WrappedResult`` for every goal that was sent, whatever becomes
    of it; one marked ``@on_feedback(client)`` gets the feedback.

    Args:
        goal: What is asked for.
        feedback: What is published on the way.
        result: What is returned at the end.
        timeout_ms: How long one try to send, cancel or ask for a result may take on the node's clock.
        retries: How often it is repeated; the server does it once.
        lease_ms: Wall clock: a server that is silent for longer is not expected to answer, and its goals
            are ``unknown``.
    """

    kind = "action_client"

    def __init__(
        self,
        goal: type[Goal],
        feedback: type[Feedback],
        result: type[Result],
        *,
        timeout_ms: float = 1000.0,
        retries: int = 2,
        lease_ms: float = 5000.0,
    ) -> None:
        self.messages = goal, feedback, result
        self.types = wire.action_types(goal, feedback, result)
        self.timeout_ms, self.retries, self.lease_ms = timeout_ms, retries, lease_ms


class Mark(NamedTuple):
    """What a method is for.

    Attributes:
        port: Whose.
        role: ``handle``: the port itself; ``event``; of an action ``accept``, ``cancel`` and ``feedback``.
        hz: Of an action's ``handle``: the parameter with the rate of its steps; "": there are none.
    """

    port: Any
    role: str = "handle"
    hz: str = ""


MARKS = "__palp_marks__"


def _mark(port: Port, role: str = "handle", hz: str = "") -> Callable[[Handler], Handler]:
    def mark(handler: Handler) -> Handler:
        if isinstance(port, Timer) and not port.name:
            port.name = handler.__name__
        handler.__dict__.setdefault(MARKS, []).append(Mark(port, role, hz))
        return handler

    return mark


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
    """Mark the method that runs when a QoS policy is broken, or a call gets no answer.

    Of an output: when readers have lost messages for good.
    """
    return _mark(port, "event")


def serve(
    port: Srv[Request, Reply],
) -> Callable[[Callable[[Any, Request], Reply]], Callable[[Any, Request], Reply]]:
    """Mark the method that answers a service."""
    return _mark(port)


def every(hz: str) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Mark a method that runs at the rate that the named parameter gives in Hz."""
    return _mark(Timer(hz, running=True))


def execute(
    port: Act[Goal, Feedback, Result], hz: str = ""
) -> Callable[
    [Callable[[Any, GoalHandle[Goal, Feedback, Result]], None]],
    Callable[[Any, GoalHandle[Goal, Feedback, Result]], None],
]:
    """Mark the method that works on a goal.

    Args:
        port: The action.
        hz: Names the parameter with the rate in Hz at which the method is called for every goal that is
            executed, until it has ended. Without it the method is called once, when the goal begins, and
            other handlers go on from there.
    """
    return _mark(port, hz=hz)


def accept(
    port: Act[Goal, Feedback, Result],
) -> Callable[[Callable[[Any, Goal], None]], Callable[[Any, Goal], None]]:
    """Mark the method that checks a goal before palp accepts it; it may raise ``GoalRejected``."""
    return _mark(port, "accept")


def on_cancel(
    port: Act[Goal, Feedback, Result],
) -> Callable[
    [Callable[[Any, GoalHandle[Goal, Feedback, Result]], None]],
    Callable[[Any, GoalHandle[Goal, Feedback, Result]], None],
]:
    """Mark the method that runs when a client cancels a goal; it may raise ``CancelRejected``."""
    return _mark(port, "cancel")


def on_feedback(
    port: ActionClient[Goal, Feedback, Result],
) -> Callable[[Callable[[Any, str, Feedback], None]], Callable[[Any, str, Feedback], None]]:
    """Mark the method that gets the id of a client's goal, and the server's feedback on it."""
    return _mark(port, "feedback")


class ActionParts(NamedTuple):
    """The ports that stand for an action on the wire, and their handlers by port.

    What checks wires, carries messages, hands over, records and replays knows services, topics and timers,
    and needs to know nothing of actions.
    """

    ports: dict[str, Port]
    handlers: dict[str, Callable[..., Any]]
    event_handlers: dict[str, Callable[..., Any]]


def action_parts(
    port: Act[Any, Any, Any] | ActionClient[Any, Any, Any], handler: Callable[..., Any], hz: str
) -> ActionParts:
    """Return what an action, or a client of one, is made of; ``hz`` as in :class:`Mark`."""
    types = port.types
    services: dict[str, Any] = {
        "send_goal": (types.send_goal, wire.SendGoalReply),
        "cancel_goal": (wire.CancelGoalRequest, wire.CancelGoalReply),
        "get_result": (wire.GetResultRequest, types.get_result),
    }
    made: dict[str, Port]
    verbs: dict[str, Callable[..., Any]]
    events: dict[str, Callable[..., Any]] = {}
    if isinstance(port, Act):
        server = ActionServerEnd
        made = {name: Srv(*messages) for name, messages in services.items()}
        made["feedback"] = Pub(types.feedback_message, qos=port.qos)
        made["status"] = Pub(wire.GoalStatusArray, qos=STATUS)
        verbs = {"send_goal": server.take, "cancel_goal": server.cancel, "get_result": server.result}
        if hz:
            made["step"], verbs["step"] = Timer(hz), server.step
    else:
        client = ActionClientEnd
        options: Any = {"timeout_ms": port.timeout_ms, "retries": port.retries}
        made = {name: Client(*messages, **options) for name, messages in services.items()}
        made["feedback"] = Sub(types.feedback_message)
        made["status"] = Sub(wire.GoalStatusArray, qos=replace(STATUS, lease_ms=port.lease_ms))
        verbs = {
            "send_goal": client.on_reply,
            "cancel_goal": lambda _end, _reply: None,
            "get_result": client.on_result,
            "feedback": client.on_feedback,
            "status": client.on_status,
        }
        events = {"send_goal": client.give_up, "get_result": client.give_up, "status": client.lose_server}
    for name, own in made.items():
        own.name = part(name, port.name)
    return ActionParts(
        {own.name: own for own in made.values()},
        {part(name, port.name): _passed_on(port.name, verb, handler) for name, verb in verbs.items()},
        {part(name, port.name): _passed_on_event(port.name, verb, handler) for name, verb in events.items()},
    )


def _passed_on(action: str, verb: Callable[..., Any], handler: Callable[..., Any]) -> Callable[..., Any]:
    """Return what hands a message or tick to the live end; its failure is named by the node's own handler."""

    @functools.wraps(handler)
    def pass_on(node: Any, *message: Any) -> Any:
        return verb(node.__dict__[action], *message)

    return pass_on


def _passed_on_event(
    action: str, verb: Callable[..., Any], handler: Callable[..., Any]
) -> Callable[..., Any]:
    @functools.wraps(handler)
    def pass_on(node: Any, event: QosEvent) -> None:
        back = event.kind == "liveliness" and event.total_count % 2 == 0
        if event.kind in ("liveliness", "call_timeout") and not back:
            verb(node.__dict__[action])

    return pass_on
