"""Managed-node states: whatever is asked, only allowed transitions happen, each with its hook."""

from __future__ import annotations

from typing import ClassVar

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from palp_core.errors import LifecycleError
from palp_core.graph.messages.message import Message
from palp_core.graph.node.bench import Bench
from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor
from palp_core.graph.node.node import Node, Params
from palp_core.graph.node.ports import Pub, Sub, every, on
from palp_core.units import Hertz

ALLOWED = {
    ("unconfigured", "configure"): "inactive",
    ("inactive", "activate"): "active",
    ("active", "deactivate"): "inactive",
    ("inactive", "cleanup"): "unconfigured",
    ("unconfigured", "shutdown"): "finalized",
    ("inactive", "shutdown"): "finalized",
    ("active", "shutdown"): "finalized",
}


class Note(Message):
    text: str


class HookParams(Params):
    hz: Hertz = 10.0


class Hooked(Node):
    params: HookParams
    word = Sub(Note)
    said = Pub(Note)
    calls: ClassVar[list[str]] = []

    def on_configure(self) -> None:
        self.calls.append("configure")

    def on_activate(self) -> None:
        self.calls.append("activate")
        self.said.publish(Note(text="hello"))

    def on_deactivate(self) -> None:
        self.calls.append("deactivate")
        self.said.publish(Note(text="bye"))

    def on_cleanup(self) -> None:
        self.calls.append("cleanup")

    def on_shutdown(self) -> None:
        self.calls.append("shutdown")

    @on(word)
    def echo(self, word: Note) -> None:
        self.calls.append("word")

    @every("hz")
    def tick(self) -> None:
        self.calls.append("tick")


class LifecycleMachine(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        Hooked.calls.clear()
        self.bench = Bench(Hooked, active=False)
        self.state = "unconfigured"
        self.expected: list[str] = []
        self.waiting = 0

    @rule(transition=st.sampled_from(Transition))
    def ask(self, transition: Transition) -> None:
        target = ALLOWED.get((self.state, transition.value))
        if target is not None:
            if transition is Transition.SHUTDOWN and self.state == "active":
                self.expected.append("deactivate")
            self.expected.append(transition.value)
            self.bench.executor.transition(transition)
            self.state = target
        elif transition is Transition.SHUTDOWN:
            self.bench.executor.transition(transition)
        else:
            with pytest.raises(LifecycleError, match=self.state):
                self.bench.executor.transition(transition)

    @rule()
    def send(self) -> None:
        self.bench.feed(Hooked.word, Note(text="x"))
        if self.state == "active":
            self.expected.append("word")
        else:
            self.waiting += 1

    @rule()
    def wait(self) -> None:
        self.bench.advance(0.1)
        if self.state == "active":
            self.expected.append("tick")

    @invariant()
    def only_an_active_node_works(self) -> None:
        executor = self.bench.executor
        assert executor.lifecycle.value == self.state
        assert Hooked.calls == self.expected
        assert len(executor.inbox) == self.waiting
        assert (executor.next_due_ns() is not None) == (self.state == "active")


TestLifecycle = LifecycleMachine.TestCase
TestLifecycle.settings = settings(deadline=None, max_examples=40, stateful_step_count=25)


def test_the_table_is_the_one_of_managed_nodes() -> None:
    for state in Lifecycle:
        for transition in Transition:
            target = ALLOWED.get((state.value, transition.value))
            if target is None:
                with pytest.raises(
                    LifecycleError, match=f"cannot {transition.value} a node that is {state.value}"
                ):
                    successor(state, transition)
            else:
                assert successor(state, transition).value == target


class Eager(Node):
    said = Pub(Note)

    def on_configure(self) -> None:
        self.said.publish(Note(text="nobody is listening yet"))


def test_a_node_that_publishes_before_its_activation_is_told_so() -> None:
    with pytest.raises(Exception, match=r"on_configure failed: /node/said: .*on_activate"):
        Bench(Eager)


def test_what_a_node_says_while_it_starts_and_stops_is_published() -> None:
    bench = Bench(Hooked)
    bench.executor.transition(Transition.SHUTDOWN)
    assert [note.text for note in bench.sent(Hooked.said)] == ["hello", "bye"]
