"""What is reported of methods and changes while a run goes on, kept for its summary."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

from palp_core.graph.launch.observers import MessageObservers
from palp_core.graph.launch.run_journal import RunJournal, last_set
from palp_core.graph.messages.builtin import GraphEvent, MethodsUsed, MethodUse, NodeEvent
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.spec import GRAPH_EVENTS


def swapped(at_s: float, before: str, after: str, **given: Any) -> GraphEvent:
    """Return what the launcher reports of a swap."""
    data = {"node": "policy", "at_s": at_s, "before": before, "after": after, "given": given}
    return GraphEvent(stamp_ns=0, kind="swapped", node="policy", text="", data=json.dumps(data))


def parameters(at_s: float, **changed: Any) -> NodeEvent:
    """Return what a node reports of parameters, each with the value before and after."""
    return NodeEvent(stamp_ns=round(at_s * 1e9), kind="parameters", text="", data=json.dumps(changed))


def methods(at_s: float, **names: str) -> MethodsUsed:
    """Return what a node reports: the method of each task."""
    uses = [MethodUse(task=task, name=name) for task, name in names.items()]
    return MethodsUsed(stamp_ns=round(at_s * 1e9), uses=uses)


def test_changes_are_in_times_order_though_a_swap_is_reported_after_its_probation() -> None:
    journal = RunJournal()
    journal.add_event("/policy/_events", parameters(1.0, ring_mm=[16.0, 4.0]))
    journal.add_event("/policy/_events", parameters(3.0, ring_mm=[16.0, 12.0]))
    journal.add_event(GRAPH_EVENTS, swapped(2.0, "m:Markov", "m:Fixed"))
    journal.add_event("/policy/_events", NodeEvent(stamp_ns=0, kind="message_lost", text="", data="{}"))
    changes = journal.entries.changes
    assert [(one.at_s, one.before, one.run, one.params) for one in changes] == [
        (1.0, "", "", {"ring_mm": 4.0}),
        (2.0, "m:Markov", "m:Fixed", {}),
        (3.0, "", "", {"ring_mm": 12.0}),
    ]
    assert last_set(changes, "policy") == {"ring_mm": 12.0}
    assert last_set(changes, "stage") == {}


def test_another_class_begins_with_its_own_parameters_and_the_same_one_keeps_what_was_set() -> None:
    journal = RunJournal()
    journal.add_event("/policy/_events", parameters(1.0, ring_mm=[16.0, 4.0], other=[1, 2]))
    journal.add_event(GRAPH_EVENTS, swapped(2.0, "m:Fixed", "m:Fixed", ring_mm=8.0))
    assert last_set(journal.entries.changes, "policy") == {"ring_mm": 8.0, "other": 2}
    journal.add_event(GRAPH_EVENTS, swapped(3.0, "m:Fixed", "m:Markov"))
    assert last_set(journal.entries.changes, "policy") == {}


def test_a_method_has_a_begin_and_an_end_and_one_that_is_reported_again_is_there_once() -> None:
    journal = RunJournal()
    journal.add_methods("estimator", methods(0.0, stop="a", feature="peak"))
    journal.add_methods("policy", methods(0.0, policy="markov"))
    journal.add_methods("estimator", methods(5.0, stop="a", feature="peak"))  # a successor reports it again
    journal.add_methods("estimator", methods(7.0, stop="b", feature="peak"))
    journal.add_methods("estimator", methods(9.0, stop="b"))
    found = [(one.node, one.use.task, one.use.name, one.at_s, one.until_s) for one in journal.entries.methods]
    assert found == [
        ("estimator", "stop", "a", 0.0, 7.0),
        ("estimator", "feature", "peak", 0.0, 9.0),
        ("policy", "policy", "markov", 0.0, None),
        ("estimator", "stop", "b", 7.0, None),
    ]


def test_an_observer_gets_messages_and_no_statement_that_a_topic_is_idle() -> None:
    observers, seen = MessageObservers(), list[Any]()
    observers.add(GraphEvent, lambda *message: seen.append(message))
    observers.follow(SimpleNamespace(topics={}, nodes=()))  # type: ignore[arg-type]
    event = swapped(1.0, "a:A", "b:B")
    type_hash = schema_of(GraphEvent).type_hash
    for kind, payload in ((Kind.IDLE, b""), (Kind.DATA, encode(event))):
        observers(5, pack(GRAPH_EVENTS.encode(), kind, 0, 1, 5, type_hash, payload))
    assert seen == [(5, GRAPH_EVENTS, event)]
