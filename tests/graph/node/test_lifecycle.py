"""Managed-node states: whatever is asked, only allowed transitions happen, each with its hook."""

from typing import Any, ClassVar

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from palp_core import Bench, Message, Node, Params, Pub, Sub, every, on
from palp_core.errors import LifecycleError, NodeError
from palp_core.graph.node.lifecycle import Transition
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
        self.published: list[str] = []
        self.waiting = 0

    @rule(transition=st.sampled_from(Transition))
    def ask(self, transition: Transition) -> None:
        target = ALLOWED.get((self.state, transition.value))
        if target is not None:
            if self.state == "active":
                self.published.append("bye")
                self.expected += ["deactivate"] if transition is Transition.SHUTDOWN else []
            self.published += ["hello"] if target == "active" else []
            self.expected.append(transition.value)
            self.bench.executor.transition(transition)
            self.state = target
        elif transition is Transition.SHUTDOWN:
            self.bench.executor.transition(transition)
        else:
            words = f"cannot {transition.value} a node that is {self.state}"
            with pytest.raises(LifecycleError, match=words):
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
        assert [note.text for note in self.bench.sent(Hooked.said)] == self.published
        assert len(executor.inbox) == self.waiting
        assert (executor.next_due_ns() is not None) == (self.state == "active")


TestLifecycle = LifecycleMachine.TestCase
TestLifecycle.settings = settings(max_examples=40, stateful_step_count=25)


def test_a_node_that_publishes_before_its_activation_is_told_so() -> None:
    def publish(node: Any) -> None:
        node.said.publish(Note(text="nobody is listening yet"))

    eager = type("Eager", (Node,), {"said": Pub(Note), "on_configure": publish})
    with pytest.raises(NodeError, match=r"on_configure failed: .*/node/said: .*on_activate"):
        Bench(eager)
