"""What a node declares of actions: goals that take time, with feedback, a result, and a way to cancel them.

A handler of an action is a plain function as any other, and ends soon: what a goal has reached is in the
node's state. So a node may be swapped, written down and replayed in the middle of a goal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar, overload

from palp_core.graph.actions.server import WhenBusy
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.ports import HANDLES, Port

Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Result = TypeVar("Result", bound=Message)
GoalSent = TypeVar("GoalSent", bound=Message, contravariant=True)
GoalGiven = TypeVar("GoalGiven", bound=Message, covariant=True)
FeedbackSent = TypeVar("FeedbackSent", bound=Message, contravariant=True)
ResultSent = TypeVar("ResultSent", bound=Message, contravariant=True)
Handler = TypeVar("Handler", bound=Callable[..., Any])

HANDLES_ROLE = "__palp_handles_role__"
STEPS_AT = "__palp_steps_at__"


class GoalHandle(Protocol[GoalGiven, FeedbackSent, ResultSent]):
    """A goal, in the hands of the server that accepted it."""

    @property
    def goal_id(self) -> str:
        """The name of the goal, which its client chose."""

    @property
    def request(self) -> GoalGiven:
        """What is to be reached."""

    @property
    def status(self) -> str:
        """``accepted``, ``executing``, ``canceling``, ``succeeded``, ``canceled`` or ``aborted``."""

    @property
    def accepted_ns(self) -> int:
        """When it was accepted, on the graph's clock."""

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""

    @property
    def is_cancel_requested(self) -> bool:
        """Whether it is to end as soon as that can be."""

    def publish_feedback(self, feedback: FeedbackSent) -> None:
        """Tell whoever listens how it goes."""

    def succeed(self, result: ResultSent) -> None:
        """End it: it is reached.

        Raises:
            LifecycleError: It has ended, or was never begun.
        """

    def abort(self, reason: str = "", result: ResultSent | None = None) -> None:
        """End it: it cannot be reached; the reason says why.

        Raises:
            LifecycleError: It has ended.
        """

    def canceled(self, result: ResultSent | None = None, reason: str = "") -> None:
        """End it, as was asked; the result says how far it came.

        Raises:
            LifecycleError: It has ended, or nobody asked.
        """


class ActionServer(Protocol[GoalGiven, FeedbackSent, ResultSent]):
    """The live end of an :class:`Act`."""

    @property
    def goals(self) -> Sequence[GoalHandle[GoalGiven, FeedbackSent, ResultSent]]:
        """The goals that have not ended, in the order in which they were accepted."""


class Act(Port, Generic[Goal, Feedback, Result]):
    """An action that this node serves; the method marked ``@execute(port)`` works on each goal.

    Args:
        goal: What is asked for.
        feedback: What is said on the way.
        result: What is said at the end.
        when_busy: What becomes of a goal that comes while another one is not done: ``reject``; ``queue``: it
            waits its turn; ``preempt``: it waits while the others are canceled; ``parallel``: it begins.
        qos: Of the feedback.
    """

    def __init__(
        self,
        goal: type[Goal],
        feedback: type[Feedback],
        result: type[Result],
        *,
        when_busy: WhenBusy = "reject",
        qos: Qos | None = None,
    ) -> None:
        self.goal, self.feedback, self.result = goal, feedback, result
        self.when_busy: WhenBusy = when_busy
        self.qos = qos or Qos()

    @overload
    def __get__(self, instance: None, owner: type) -> Act[Goal, Feedback, Result]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> ActionServer[Goal, Feedback, Result]: ...
    def __get__(
        self, instance: object | None, owner: type
    ) -> Act[Goal, Feedback, Result] | ActionServer[Goal, Feedback, Result]:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} serves only while an executor runs the node")


class GoalSender(Protocol[GoalSent]):
    """The live end of an :class:`ActionClient`."""

    @property
    def goals(self) -> dict[str, str]:
        """Status of each goal that has not ended, by its id; ``sent``: it is not answered yet."""

    def send_goal(self, goal: GoalSent, *, deadline_s: float = 0.0) -> str:
        """Send a goal and return its id at once.

        Args:
            goal: What is asked for.
            deadline_s: The server cancels it so long after it has accepted it; 0: never.
        """

    def cancel_goal(self, goal_id: str) -> None:
        """Ask the server to cancel a goal; one that has ended is left alone."""


class ActionClient(Port, Generic[Goal, Feedback, Result]):
    """The asking end of an action, wired in the launch file like a client: one key for the whole of it.

    The method marked ``@on(client)`` gets a ``WrappedResult`` for every goal that was sent, whatever becomes
    of it; one marked ``@on_feedback(client)`` hears how it goes.

    Args:
        goal: What is asked for.
        feedback: What is said on the way.
        result: What is said at the end.
        timeout_ms: How long one try to send, cancel or ask for a result may take on the node's clock.
        retries: How often it is repeated; the server does it once.
        lease_ms: Wall clock: a server that is silent for longer is not expected to answer, and its goals
            are ``unknown``.
    """

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
        self.goal, self.feedback, self.result = goal, feedback, result
        self.timeout_ms, self.retries, self.lease_ms = timeout_ms, retries, lease_ms

    @overload
    def __get__(self, instance: None, owner: type) -> ActionClient[Goal, Feedback, Result]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> GoalSender[Goal]: ...
    def __get__(
        self, instance: object | None, owner: type
    ) -> ActionClient[Goal, Feedback, Result] | GoalSender[Goal]:
        if instance is None:
            return self
        raise AttributeError(f"{owner.__name__}.{self.name} sends only while an executor runs the node")


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

    def mark(handler: Handler) -> Handler:
        handler.__dict__[HANDLES] = port
        handler.__dict__[STEPS_AT] = hz
        return handler

    return mark


def accept(
    port: Act[Goal, Feedback, Result],
) -> Callable[[Callable[[Any, Goal], None]], Callable[[Any, Goal], None]]:
    """Mark the method that looks at a goal before it is accepted, and may raise ``GoalRejected``."""
    return _mark_role(port, "accept")


def on_cancel(
    port: Act[Goal, Feedback, Result],
) -> Callable[
    [Callable[[Any, GoalHandle[Goal, Feedback, Result]], None]],
    Callable[[Any, GoalHandle[Goal, Feedback, Result]], None],
]:
    """Mark the method that is told that a goal is to be canceled, and may raise ``CancelRejected``."""
    return _mark_role(port, "cancel")


def on_feedback(
    port: ActionClient[Goal, Feedback, Result],
) -> Callable[[Callable[[Any, str, Feedback], None]], Callable[[Any, str, Feedback], None]]:
    """Mark the method that gets the id of a goal of this client and what the server says of it."""
    return _mark_role(port, "feedback")


def _mark_role(port: Port, role: str) -> Callable[[Handler], Handler]:
    def mark(handler: Handler) -> Handler:
        handler.__dict__[HANDLES_ROLE] = (port, role)
        return handler

    return mark
