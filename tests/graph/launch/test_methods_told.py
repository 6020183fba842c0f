"""What nodes say of their methods, kept for the run's summary."""

from __future__ import annotations

from palp_core.graph.launch.methods_told import MethodsTold
from palp_core.graph.messages.builtin import MethodsUsed, MethodUse


def said(at_s: float, **names: str) -> MethodsUsed:
    """Return what a node says: the method of each task."""
    uses = [MethodUse(task=task, name=name) for task, name in names.items()]
    return MethodsUsed(stamp_ns=round(at_s * 1e9), uses=uses)


def test_a_method_is_told_from_when_on_and_until_when_and_what_is_said_again_is_told_once() -> None:
    told = MethodsTold()
    told.note("estimator", said(0.0, stop="a", feature="peak"))
    told.note("policy", said(0.0, policy="markov"))
    told.note("estimator", said(5.0, stop="a", feature="peak"))  # a successor says it again
    told.note("estimator", said(7.0, stop="b", feature="peak"))
    told.note("estimator", said(9.0, stop="b"))
    found = [(one.node, one.use.task, one.use.name, one.at_s, one.until_s) for one in told.told]
    assert found == [
        ("estimator", "stop", "a", 0.0, 7.0),
        ("estimator", "feature", "peak", 0.0, 9.0),
        ("policy", "policy", "markov", 0.0, None),
        ("estimator", "stop", "b", 7.0, None),
    ]
