"""What is changed of nodes while a run goes on, kept for the run's summary."""

from __future__ import annotations

import json
from typing import Any

from palp_core.graph.launch.changes_told import GRAPH_EVENTS, ChangesTold, last_set
from palp_core.graph.messages.builtin import GraphEvent, NodeEvent


def swapped(at_s: float, before: str, after: str, **given: Any) -> GraphEvent:
    """Return what the launcher says of a swap."""
    data = {"node": "policy", "at_s": at_s, "before": before, "after": after, "given": given}
    return GraphEvent(stamp_ns=0, kind="swapped", node="policy", text="", data=json.dumps(data))


def parameters(at_s: float, **changed: Any) -> NodeEvent:
    """Return what a node says of parameters, each with the value before and after."""
    return NodeEvent(stamp_ns=round(at_s * 1e9), kind="parameters", text="", data=json.dumps(changed))


def test_changes_are_told_in_times_order_though_a_swap_is_told_after_its_probation() -> None:
    told = ChangesTold()
    told.note("/policy/_events", parameters(1.0, ring_mm=[16.0, 4.0]))
    told.note("/policy/_events", parameters(3.0, ring_mm=[16.0, 12.0]))
    told.note(GRAPH_EVENTS, swapped(2.0, "m:Markov", "m:Fixed"))
    told.note("/policy/_events", NodeEvent(stamp_ns=0, kind="message_lost", text="", data="{}"))
    assert [(one.at_s, one.before, one.run, one.params) for one in told.told] == [
        (1.0, "", "", {"ring_mm": 4.0}),
        (2.0, "m:Markov", "m:Fixed", {}),
        (3.0, "", "", {"ring_mm": 12.0}),
    ]
    assert last_set(told.told, "policy") == {"ring_mm": 12.0}
    assert last_set(told.told, "stage") == {}


def test_another_class_begins_with_its_own_parameters_and_the_same_one_keeps_what_was_set() -> None:
    told = ChangesTold()
    told.note("/policy/_events", parameters(1.0, ring_mm=[16.0, 4.0], other=[1, 2]))
    told.note(GRAPH_EVENTS, swapped(2.0, "m:Fixed", "m:Fixed", ring_mm=8.0))
    assert last_set(told.told, "policy") == {"ring_mm": 8.0, "other": 2}
    told.note(GRAPH_EVENTS, swapped(3.0, "m:Fixed", "m:Markov"))
    assert last_set(told.told, "policy") == {}
