"""The safety machine: no sequence of events reaches motion while tripped; only `ack` clears; all latches."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from palp_core.palpation.devices.safety.state_machine import (
    Action,
    Cause,
    Event,
    SafetyMachine,
    SafetyState,
)

TRIPPED = {SafetyState.STOPPING, SafetyState.LATCHED}
PERMITTED = {SafetyState.READY, SafetyState.MOVING}


def ruled(state: SafetyState, event: Event) -> tuple[SafetyState, tuple[Action, ...]]:
    """Return what six rules say; what none of them names changes nothing and asks for nothing."""
    steps = {
        (SafetyState.STARTING, Event.COMPLETE): SafetyState.READY,  # the only way to a permission
        (SafetyState.READY, Event.MOVES): SafetyState.MOVING,
        (SafetyState.MOVING, Event.RESTS): SafetyState.READY,
        (SafetyState.STOPPING, Event.STOPPED): SafetyState.LATCHED,  # the only way to the latch
    }
    unpermitted = event is Event.MOVES and state not in PERMITTED
    if state in TRIPPED and unpermitted:
        return SafetyState.STOPPING, (Action.STOP,)
    if state not in TRIPPED and (unpermitted or event is Event.TRIP):
        return SafetyState.STOPPING, (Action.STOP, Action.RECORD)
    if (state, event) == (SafetyState.LATCHED, Event.ACKNOWLEDGE):
        return SafetyState.STARTING, (Action.RELEASE,)
    return steps.get((state, event), state), ()


def test_every_event_in_every_state_does_what_the_rules_say_and_nothing_else() -> None:
    for state in SafetyState:
        for event in Event:
            machine = SafetyMachine(state)
            actions = machine.handle(event)
            assert (machine.state, actions) == ruled(state, event), f"{state}: {event}"


def test_every_cause_latches() -> None:
    for cause in Cause:
        machine = SafetyMachine(SafetyState.MOVING)
        machine.handle(Event.TRIP, cause, "why")
        machine.handle(Event.STOPPED)
        for event in set(Event) - {Event.ACKNOWLEDGE}:
            machine.handle(event, Cause.OPERATOR, "another")
            assert machine.tripped
            assert (machine.cause, machine.text) == (cause, "why")


class SafetyWalk(RuleBasedStateMachine):
    """A rig that does as commanded, in whatever order things happen to it."""

    def __init__(self) -> None:
        super().__init__()
        self.machine = SafetyMachine()
        self.moving = False
        self.enabled = True
        self.tripped_by: Cause | None = None
        self.acknowledged = 0

    def take(self, event: Event, cause: Cause | None = None) -> None:
        actions = self.machine.handle(event, cause, "why")
        if Action.STOP in actions:
            self.moving = self.enabled = False
        if Action.RELEASE in actions:
            self.enabled = True
            self.acknowledged += 1

    @initialize(state=st.sampled_from([SafetyState.STARTING, SafetyState.READY, SafetyState.MOVING]))
    def it_begins_in_the_middle(self, state: SafetyState) -> None:
        """Else nearly every walk is tripped before anything is permitted."""
        self.machine, self.moving = SafetyMachine(state), state is SafetyState.MOVING

    @rule()
    def somebody_asks_for_motion(self) -> None:
        """The stage obeys the permission; it asks and is refused while there is none."""
        if self.machine.permits and self.enabled:
            self.moving = True
            self.take(Event.MOVES)

    @rule()
    def something_moves_without_permission(self) -> None:
        if not self.machine.permits:
            was = self.machine.tripped
            self.moving = True
            self.take(Event.MOVES)
            if not was:
                self.tripped_by = Cause.UNPERMITTED

    @rule()
    def it_comes_to_rest(self) -> None:
        self.moving = False
        self.take(Event.RESTS)

    @rule(cause=st.sampled_from(list(Cause)))
    def a_limit_is_passed(self, cause: Cause) -> None:
        if not self.machine.tripped:
            self.tripped_by = cause
        self.take(Event.TRIP, cause)
        assert self.machine.tripped

    @rule()
    def everything_was_received(self) -> None:
        self.take(Event.COMPLETE)

    @rule()
    def the_stop_is_confirmed(self) -> None:
        self.take(Event.STOPPED)

    @rule()
    def somebody_acknowledges_too_early(self) -> None:
        was = self.machine.tripped
        self.take(Event.ACKNOWLEDGE_EARLY)
        assert self.machine.tripped == was

    @precondition(lambda self: self.machine.state is SafetyState.LATCHED)
    @rule()
    def somebody_acknowledges(self) -> None:
        self.take(Event.ACKNOWLEDGE)
        assert not self.machine.tripped
        assert not self.machine.permits
        self.tripped_by = None

    @precondition(lambda self: self.machine.state is not SafetyState.LATCHED)
    @rule()
    def somebody_acknowledges_what_is_not_latched(self) -> None:
        was = self.machine.tripped
        self.take(Event.ACKNOWLEDGE)
        assert self.machine.tripped == was

    @invariant()
    def nothing_moves_while_tripped(self) -> None:
        if self.machine.tripped:
            assert not self.moving
            assert not self.enabled
            assert not self.machine.permits

    @invariant()
    def a_trip_keeps_its_first_cause_until_it_is_acknowledged(self) -> None:
        assert self.machine.cause == self.tripped_by
        assert self.machine.tripped == (self.tripped_by is not None)
        assert self.machine.acknowledged_count == self.acknowledged


TestSafetyWalk = SafetyWalk.TestCase
TestSafetyWalk.settings = settings(max_examples=30, stateful_step_count=40, deadline=None)
