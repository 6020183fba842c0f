"""A goal: accepted or refused, worked on, canceled, ended once and heard of, through any change of hands."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core import (
    Act,
    ActionClient,
    Bench,
    GoalHandle,
    Message,
    Node,
    Params,
    Pub,
    State,
    WrappedResult,
    accept,
    execute,
    on,
    on_cancel,
    on_feedback,
)
from palp_core.errors import CancelRejected, GoalRejected, NodeError
from palp_core.graph.node.action_server import MOST_LIVE
from palp_core.graph.node.lifecycle import Transition

ENDS = {"succeeded", "canceled", "aborted"}
FOLLOWS = {
    "": {"accepted"},
    "accepted": {"executing", "canceled", "aborted"},
    "executing": {"canceling", "succeeded", "aborted"},
    "canceling": {"canceled", "succeeded", "aborted", "executing"},
    **{status: set[str]() for status in ENDS},
}


class Lift(Message):
    floors: int


class Passing(Message):
    floor: int


class Arrived(Message):
    floor: int


class LiftParams(Params):
    step_hz: float = 10.0
    stubborn: bool = False


class LiftState(State):
    floor: int = 0


class Elevator(Node):
    """A floor per step; what is above the roof is refused, what is below the ground cannot be reached."""

    params: LiftParams
    state: LiftState
    lift = Act(Lift, Passing, Arrived)

    @accept(lift)
    def look(self, goal: Lift) -> None:
        if goal.floors > 100:
            raise GoalRejected("above the roof")

    @on_cancel(lift)
    def hold(self, goal: GoalHandle[Lift, Passing, Arrived]) -> None:
        if self.params.stubborn:
            raise CancelRejected("between two floors")

    @execute(lift, "step_hz")
    def rise(self, goal: GoalHandle[Lift, Passing, Arrived]) -> None:
        if goal.is_cancel_requested:
            goal.canceled(Arrived(floor=self.state.floor))
        elif goal.request.floors < 0:
            goal.abort("below the ground")
        elif self.state.floor == goal.request.floors:
            goal.succeed(Arrived(floor=self.state.floor))
        else:
            self.state.floor += 1 if goal.request.floors > self.state.floor else -1
            goal.publish_feedback(Passing(floor=self.state.floor))


def elevator(when_busy: str) -> type[Elevator]:
    """The elevator with another rule for goals that come while it is busy."""

    class Other(Elevator):
        lift = Act(Lift, Passing, Arrived, when_busy=when_busy)  # type: ignore[arg-type]

        @execute(lift, "step_hz")
        def rise(self, goal: GoalHandle[Lift, Passing, Arrived]) -> None:
            Elevator.rise(self, goal)

    return Other


class Guest(Node):
    """Notes all that it hears."""

    class Heard(State):
        ended: list[str] = []
        floors: list[int] = []

    state: Heard
    lift = ActionClient(Lift, Passing, Arrived, timeout_ms=100, retries=1, lease_ms=500)

    @on(lift)
    def leave(self, ended: WrappedResult[Arrived]) -> None:
        floor = "" if ended.result is None else f" at {ended.result.floor}"
        self.state.ended.append(f"{ended.status}{floor}: {ended.reason}".removesuffix(": "))

    @on_feedback(lift)
    def watch(self, goal_id: str, feedback: Passing) -> None:
        self.state.floors.append(feedback.floor)


def test_a_goal_is_accepted_worked_on_and_ended_with_its_result() -> None:
    bench = Bench(Elevator)
    lift = bench.action(Elevator.lift)
    assert lift.send_goal(Lift(floors=3)).accepted
    bench.advance(1.0)
    assert lift.statuses() == ["accepted", "executing", "succeeded"]
    assert [message.floor for message in lift.feedback()] == [1, 2, 3]
    assert lift.result().result == [Arrived(floor=3)]
    assert bench.executor.next_due_ns() is None  # no goal, no step


def test_a_goal_that_a_node_refuses_is_rejected_with_its_reason() -> None:
    lift = Bench(Elevator).action(Elevator.lift)
    reply = lift.send_goal(Lift(floors=101))
    assert (reply.accepted, reply.reason) == (False, "above the roof")
    assert not lift.send_goal(Lift(floors=1), "").accepted
    assert lift.result().status == "unknown"


def test_a_goal_that_is_sent_twice_is_done_once() -> None:
    bench = Bench(Elevator)
    lift = bench.action(Elevator.lift)
    assert lift.send_goal(Lift(floors=2)).accepted
    assert lift.send_goal(Lift(floors=2)).accepted
    bench.advance(1.0)
    assert lift.send_goal(Lift(floors=2)).accepted
    assert lift.statuses() == ["accepted", "executing", "succeeded"]


def test_a_cancel_ends_a_goal_where_it_is_unless_the_node_refuses() -> None:
    bench = Bench(Elevator)
    lift = bench.action(Elevator.lift)
    lift.send_goal(Lift(floors=9))
    bench.advance(0.25)
    assert lift.cancel_goal("goal").goal_ids == ["goal"]
    bench.advance(0.1)
    assert lift.statuses() == ["accepted", "executing", "canceling", "canceled"]
    assert lift.result().result == [Arrived(floor=2)]
    assert lift.cancel_goal("goal").reason == "goal goal has ended"
    assert lift.cancel_goal("none").reason == "goal none is not known"
    bench.set_parameters(stubborn=True)
    lift.send_goal(Lift(floors=3), "second")
    bench.advance(0.1)
    refused = lift.cancel_goal()
    assert (refused.goal_ids, refused.reason) == ([], "goal second: between two floors")
    bench.advance(1.0)
    assert lift.result("second").status == "succeeded"


@pytest.mark.parametrize(
    ("when_busy", "first", "second"),
    [
        ("reject", "succeeded", None),
        ("queue", "succeeded", "succeeded"),
        ("preempt", "canceled", "succeeded"),
        ("parallel", "succeeded", "succeeded"),
    ],
)
def test_what_becomes_of_a_goal_while_another_is_not_done(
    when_busy: str, first: str, second: str | None
) -> None:
    kind = elevator(when_busy)
    bench = Bench(kind)
    lift = bench.action(kind.lift)
    lift.send_goal(Lift(floors=5), "first")
    bench.advance(0.15)
    reply = lift.send_goal(Lift(floors=2), "second")
    assert reply.accepted is (second is not None)
    if second is None:
        assert "busy with goal first" in reply.reason
    bench.advance(2.0)
    assert lift.result("first").status == first
    assert lift.result("second").status == (second or "unknown")
    if when_busy == "preempt":
        assert lift.result("first").reason == "preempted by goal second"


@pytest.mark.parametrize("when_busy", ["queue", "parallel"])
def test_a_server_has_so_many_goals_to_do_and_no_more(when_busy: str) -> None:
    kind = elevator(when_busy)
    bench = Bench(kind)
    lift = bench.action(kind.lift)
    replies = [lift.send_goal(Lift(floors=1), str(n)) for n in range(MOST_LIVE + 1)]
    assert [reply.accepted for reply in replies] == [True] * MOST_LIVE + [False]
    assert "64 goals to do; cancel one" in replies[-1].reason
    assert len(lift.cancel_goal().goal_ids) == MOST_LIVE
    bench.advance(0.2)
    assert lift.send_goal(Lift(floors=1), "next").accepted


def test_a_goal_that_outlasts_its_deadline_is_canceled_by_its_server() -> None:
    bench = Bench(Elevator)
    lift = bench.action(Elevator.lift)
    lift.send_goal(Lift(floors=50), deadline_s=0.25)
    bench.advance(1.0)
    told = lift.result()
    assert (told.status, told.reason) == ("canceled", "its deadline has passed")
    assert len(lift.feedback()) == 2


def test_goals_of_a_node_that_is_deactivated_are_aborted() -> None:
    bench = Bench(Elevator)
    lift = bench.action(Elevator.lift)
    lift.send_goal(Lift(floors=50))
    bench.executor.transition(Transition.DEACTIVATE)
    assert lift.statuses()[-1] == "aborted"
    bench.executor.transition(Transition.ACTIVATE)
    bench.advance(0.0)
    assert lift.result().status == "unknown"


def test_goals_of_a_node_that_fails_are_aborted_and_say_of_what() -> None:
    class Falls(Elevator):
        @execute(Elevator.lift, "step_hz")
        def rise(self, goal: GoalHandle[Lift, Passing, Arrived]) -> None:
            raise ValueError("the rope is torn")

    bench = Bench(Falls)
    lift = bench.action(Falls.lift)
    lift.send_goal(Lift(floors=1))
    with pytest.raises(
        NodeError, match=r"rise \(handler of 'lift/_action/step'\) failed: ValueError: the rope"
    ):
        bench.advance(1.0)
    assert lift.statuses()[-1] == "aborted"


@pytest.mark.parametrize(
    ("deed", "text"),
    [
        (lambda goal: goal.canceled(), "is executing; to end it as canceled it must be canceling"),
        (lambda goal: [goal.succeed(Arrived(floor=1)), goal.abort()], "is succeeded; to abort it it must be"),
        (lambda goal: goal.succeed(Passing(floor=1)), "carries Arrived here, not Passing"),
    ],
)
def test_an_end_that_a_goal_cannot_have_is_the_nodes_failure(deed: Callable[[Any], None], text: str) -> None:
    class Once(Node):
        lift = Act(Lift, Passing, Arrived)

        @execute(lift)
        def begin(self, goal: GoalHandle[Lift, Passing, Arrived]) -> None:
            deed(goal)

    bench = Bench(Once)
    with pytest.raises(NodeError, match=text):
        bench.action(Once.lift).send_goal(Lift(floors=1))


def test_results_of_the_latest_goals_are_kept_for_who_asks_late() -> None:
    bench = Bench(Elevator)
    lift = bench.action(Elevator.lift)
    for number in range(33):
        lift.send_goal(Lift(floors=0), f"g{number}")
        bench.advance(0.1)
    assert lift.result("g0").status == "unknown"
    assert lift.result("g1").result == [Arrived(floor=0)]


def guest() -> tuple[Bench[Guest], Any]:
    bench = Bench(Guest, name="guest")
    return bench, bench.action(Guest.lift)


def test_a_client_hears_of_each_goal_how_it_goes_and_ends() -> None:
    bench, server = guest()
    goal_id = bench.node.lift.send_goal(Lift(floors=2))
    assert (goal_id, bench.node.lift.goals) == ("guest.lift-0-1", {goal_id: "sent"})
    server.accept()
    server.feedback(Passing(floor=1))
    server.end("succeeded", Arrived(floor=2))
    bench.node.lift.send_goal(Lift(floors=101))
    server.reject("above the roof")
    bench.node.lift.send_goal(Lift(floors=-1))
    server.accept()
    server.end("aborted", reason="below the ground")
    assert bench.node.state.floors == [1]
    assert bench.node.state.ended == [
        "succeeded at 2", "rejected: above the roof", "aborted: below the ground",
    ]  # fmt: skip
    assert bench.node.lift.goals == {}


def test_a_client_of_a_server_that_does_not_answer_hears_unknown() -> None:
    bench, server = guest()
    bench.node.lift.send_goal(Lift(floors=2))
    bench.advance(1.0)
    assert bench.node.state.ended == ["unknown: its server did not answer"]
    assert len(server.goals) == 1


def test_a_result_that_does_not_come_leaves_the_end_known() -> None:
    bench, server = guest()
    bench.node.lift.send_goal(Lift(floors=2))
    server.accept()
    bench.reply = lambda port, message: None  # type: ignore[method-assign]
    server.end("succeeded", Arrived(floor=2))
    bench.advance(1.0)
    assert bench.node.state.ended == ["succeeded: its server did not send the result"]


def test_a_client_cancels_only_what_has_not_ended() -> None:
    bench, server = guest()
    goal_id = bench.node.lift.send_goal(Lift(floors=2))
    bench.node.lift.cancel_goal(goal_id)
    bench.node.lift.cancel_goal("another")
    assert server.canceled == [goal_id]


WORDS = st.lists(
    st.one_of(
        st.tuples(st.just("send"), st.integers(-1, 5)),
        st.tuples(st.just("cancel"), st.integers(0, 4)),
        st.tuples(st.just("wait"), st.integers(0, 4)),
        st.tuples(st.just("swap"), st.just(0)),
        st.tuples(st.just("stubborn"), st.integers(0, 1)),
    ),
    max_size=25,
)


@given(words=WORDS, when_busy=st.sampled_from(["reject", "queue", "preempt", "parallel"]))
def test_a_goal_goes_only_where_its_status_allows_and_ends_through_any_change_of_hands(
    words: list[tuple[str, int]], when_busy: str
) -> None:
    kind = elevator(when_busy)
    bench: Bench[Any] = Bench(kind)
    said: list[dict[str, str]] = []
    taken: list[str] = []

    def note() -> None:
        messages = bench.sent(bench.executor.declaration.of(Pub)["lift/_action/status"])
        said.extend({entry.goal_id: entry.status for entry in message.status_list} for message in messages)
        bench.frames.clear()

    for number, (verb, value) in enumerate(words):
        lift = bench.action(kind.lift)
        if verb == "send" and lift.send_goal(Lift(floors=value), f"g{number}", deadline_s=2.0).accepted:
            taken.append(f"g{number}")
        elif verb == "cancel" and value < len(taken):
            lift.cancel_goal(taken[value])
        elif verb == "wait":
            bench.advance(value * 0.1)
        elif verb == "stubborn":
            bench.set_parameters(stubborn=bool(value))
        elif verb == "swap":
            note()
            successor: Bench[Any] = Bench(kind, active=False)
            successor.clock.set(bench.clock.now_ns())
            successor.executor.transition(Transition.CONFIGURE)
            successor.executor.take_over(bench.hand_over())
            successor._sequence = bench._sequence
            bench = successor
        note()
    bench.set_parameters(stubborn=False)
    bench.advance(0.0)
    while bench.executor.ends.action_servers["lift"].goals:
        bench.action(kind.lift).cancel_goal()
        bench.advance(0.2)
    note()
    for goal in taken:
        path = [""]
        for status in (one[goal] for one in said if goal in one):
            if status != path[-1]:
                assert status in FOLLOWS[path[-1]], (goal, [*path, status])
                path.append(status)
        assert path[-1] in ENDS
