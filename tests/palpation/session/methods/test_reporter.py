"""A node of one's own says its methods by one base class: at its start, when they change, and not twice."""

from __future__ import annotations

from palp_core import Params
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.bench import Bench
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.session.methods.reporter import MethodReporter
from palp_core.palpation.session.methods.used import used


class StoppingParams(Params):
    stop: str = "paper_guarded"


class Stopping(MethodReporter):
    """Goes by a stop rule, and does nothing with it."""

    params: StoppingParams

    def uses(self) -> list[MethodUse]:
        return [used("stop", self.params.stop)]

    def on_parameters(self, params: Params) -> None:
        if isinstance(params, StoppingParams):
            self.publish_methods([used("stop", params.stop)])


def successor(old: Bench[Stopping]) -> Bench[Stopping]:
    new = Bench(Stopping, active=False)
    new.executor.transition(Transition.CONFIGURE)
    new.executor.take_over(old.hand_over())
    return new


def told(bench: Bench[Stopping]) -> list[list[str]]:
    return [[use.name for use in said.uses] for said in bench.sent(Stopping.methods)]


def test_it_says_them_at_its_start_and_when_they_change_and_a_successor_only_what_is_new() -> None:
    first = Bench(Stopping)
    first.set_parameters(stop="paper_guarded")
    assert told(first) == [["paper_guarded"]]
    second = successor(first)
    assert told(second) == []
    second.set_parameters(stop="posterior_threshold")
    assert told(second) == [["posterior_threshold"]]
    assert Stopping.methods.qos.latched_depth > 1  # who records from later on hears of all of them


def test_one_that_does_not_know_yet_what_it_uses_says_it_later() -> None:
    class Late(MethodReporter):
        """Chooses when it is asked."""

    bench = Bench(Late)
    assert bench.sent(Late.methods) == []
    bench.node.publish_methods([used("stop")])
    assert len(bench.sent(Late.methods)) == 1
