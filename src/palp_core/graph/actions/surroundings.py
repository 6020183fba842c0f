"""What the ends of an action ask of the node that they are in, and of its other ends."""

from collections.abc import Sequence
from typing import Any, Protocol

from palp_core.graph.messages.message import Message


class Surroundings(Protocol):
    """The node that an end is in.

    Attributes:
        name: Its running name.
        epoch: How often it was restarted.
        node: What its handlers are called with.
    """

    name: str
    epoch: int
    node: Any

    def now_ns(self) -> int:
        """Return the time of the present handler."""


class Declared(Protocol):
    """An action as a class declares it, or a client of one."""

    name: str
    goal: type[Message]
    feedback: type[Message]
    result: type[Message]


class Out(Protocol):
    """A topic that is published."""

    def publish(self, message: Any) -> None:
        """Send a message to every reader."""


class Steps(Protocol):
    """The timer by which goals are worked on."""

    def start(self) -> None:
        """Tick from the next grid instant on."""

    def stop(self) -> None:
        """Tick no more."""


class Unanswered(Protocol):
    """A call on its way."""

    @property
    def sequence(self) -> int:
        """Of its request."""


class Call(Protocol):
    """The asking end of a service."""

    @property
    def pending(self) -> Sequence[Unanswered]:
        """Calls that wait for their replies, the latest last."""

    def call(self, request: Message) -> None:
        """Send a request and return at once."""
