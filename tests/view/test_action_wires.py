"""An action is one wire, from its client to its server."""

from __future__ import annotations

from palp_core.view.pages.graph import pairs_of, wire_text
from palp_core.view.source.action_wires import ACTION, actions_as_one
from palp_core.view.source.overview import WireState


def wire(topic: str, reader: str, received: int = 1, p50_s: float | None = None) -> WireState:
    source = topic.split("/")[1]
    return WireState(
        topic=topic,
        source=source,
        reader=reader,
        received=received,
        lost=0,
        late=0,
        rate_hz=2.0,
        latency_p50_s=p50_s,
    )


CALLS = ("send_goal", "cancel_goal", "get_result")
HEARD = [
    wire("/arm/pose", "carrier", 7),
    *(wire(f"/carrier/lift/_action/{call}", "arm") for call in CALLS),
    wire("/arm/move/_action/feedback", "carrier", 10, 0.25),
    wire("/arm/move/_action/status", "carrier", 6, 0.5),
    *(wire(f"/arm/move/_action/{call}/carrier/lift/_action/{call}", "carrier") for call in CALLS),
    wire("/arm/move/_action/status", "other", 6),
]


def test_the_parts_of_an_action_between_two_nodes_are_one_wire() -> None:
    pose, action, other = actions_as_one(HEARD)
    assert pose == HEARD[0]
    assert (action.source, action.reader, action.topic, action.type) == (
        "carrier",
        "arm",
        "/arm/move",
        ACTION,
    )
    assert (action.received, action.rate_hz, action.latency_p50_s) == (22, 16.0, 0.5)
    assert (other.source, other.reader, other.received) == ("other", "arm", 6)


def test_an_action_is_drawn_once_and_says_whose_it_is() -> None:
    pairs = pairs_of(actions_as_one(HEARD))
    assert {ends: len(wires) for ends, wires in pairs.items()} == {
        ("arm", "carrier"): 1,
        ("carrier", "arm"): 1,
        ("other", "arm"): 1,
    }
    text = wire_text(pairs["carrier", "arm"][0])
    assert text == "/arm/move, an action for /carrier: 22 received, 0 lost, 0 late"


def test_of_an_action_in_a_bag_whose_readers_nobody_has_counted_nothing_is_counted() -> None:
    parts = [WireState(topic=one.topic, source=one.source, reader=one.reader) for one in HEARD]
    for one in actions_as_one(parts):
        assert (one.received, one.lost, one.late, one.rate_hz, one.latency_p99_s) == (None,) * 5
        assert not any(letter.isdigit() for letter in wire_text(one))
