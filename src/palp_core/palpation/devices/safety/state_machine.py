"""The safety machine as a table: what each event does in each state; two states permit motion.

A trip leads out of every state to ``stopping``; from there only the confirmed stop leads on, to ``latched``;
from there only an acknowledgement leads on, to ``starting``, where nothing moves until everything that is
watched has reported again. A hypothesis state machine walks through it (``tests/palpation/devices``).
"""

from collections.abc import Mapping
from enum import StrEnum


class SafetyState(StrEnum):
    """State of the safety machine."""

    STARTING = "starting"
    READY = "ready"
    MOVING = "moving"
    STOPPING = "stopping"
    LATCHED = "latched"


class Event(StrEnum):
    """What can happen.

    ``acknowledge_early`` is an acknowledgement while the cause persists.
    """

    COMPLETE = "complete"
    MOVES = "moves"
    RESTS = "rests"
    TRIP = "trip"
    STOPPED = "stopped"
    ACKNOWLEDGE = "acknowledge"
    ACKNOWLEDGE_EARLY = "acknowledge early"


class Action(StrEnum):
    """What a transition asks for: ABORT, DISABLE and hold the ring; keep the last second; enable again."""

    STOP = "stop"
    RECORD = "record"
    RELEASE = "release"


class Cause(StrEnum):
    """Why motion is stopped."""

    TORQUE = "torque"
    FORCE = "force"
    SATURATED = "saturated"
    SENSOR_FAULT = "sensor fault"
    STALE = "stale"
    TRAVEL = "travel"
    SPEED = "speed"
    FOLLOWING = "following error"
    AXIS_FAULT = "axis fault"
    RING_FAULT = "ring fault"
    LINK_LOST = "lost link"
    HEARTBEAT = "lost heartbeat"
    LATE = "late host"
    OPERATOR = "operator"
    WRONG_LINK = "wrong link"
    UNPERMITTED = "unpermitted motion"


Row = tuple[SafetyState, tuple[Action, ...]]
_S, _E = SafetyState, Event
_STOP, _TRIP = (Action.STOP,), (Action.STOP, Action.RECORD)

TABLE: Mapping[SafetyState, Mapping[Event, Row]] = {
    _S.STARTING: {
        _E.COMPLETE: (_S.READY, ()),
        _E.MOVES: (_S.STOPPING, _TRIP),
        _E.TRIP: (_S.STOPPING, _TRIP),
    },
    _S.READY: {_E.MOVES: (_S.MOVING, ()), _E.TRIP: (_S.STOPPING, _TRIP)},
    _S.MOVING: {_E.RESTS: (_S.READY, ()), _E.TRIP: (_S.STOPPING, _TRIP)},
    _S.STOPPING: {_E.MOVES: (_S.STOPPING, _STOP), _E.STOPPED: (_S.LATCHED, ())},
    _S.LATCHED: {_E.MOVES: (_S.STOPPING, _STOP), _E.ACKNOWLEDGE: (_S.STARTING, (Action.RELEASE,))},
}
"""What each event does in each state; an event that is not named leaves all as it is."""


class SafetyMachine:
    """The present state, and why.

    Attributes:
        state: Present state.
        cause: Cause of the trip; None if there is none.
        text: The cause as a text.
        acknowledged_count: How many trips were acknowledged.
    """

    def __init__(
        self, state: SafetyState = SafetyState.STARTING, cause: Cause | None = None, text: str = ""
    ) -> None:
        self.state, self.cause, self.text = state, cause, text
        self.acknowledged_count = 0

    @property
    def permits(self) -> bool:
        """Whether anything may move."""
        return self.state in (SafetyState.READY, SafetyState.MOVING)

    @property
    def tripped(self) -> bool:
        """Whether a trip waits for its acknowledgement."""
        return self.state in (SafetyState.STOPPING, SafetyState.LATCHED)

    def handle(self, event: Event, cause: Cause | None = None, text: str = "") -> tuple[Action, ...]:
        """Follow the table; return what to do."""
        before = self.tripped
        self.state, actions = TABLE[self.state].get(event, (self.state, ()))
        if self.tripped and not before:
            self.cause = cause or Cause.UNPERMITTED
            self.text = text or "something moved before it was permitted"
        if Action.RELEASE in actions:
            self.cause, self.text = None, ""
            self.acknowledged_count += 1
        return actions
