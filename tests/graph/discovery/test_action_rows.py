"""What tools show of an action's topics and services is one input, not five."""

from __future__ import annotations

from palp_core.graph.discovery.health import EdgeRow, actions_as_one


def row(topic: str, reader: str, received: int, latency_s: float | None, rate_hz: float | None) -> EdgeRow:
    return EdgeRow(
        topic=topic,
        reader=reader,
        rate_hz=rate_hz,
        received=received,
        lost=1,
        repeated=0,
        late=0,
        dropped=0,
        latency_p50_s=latency_s,
        latency_p99_s=latency_s,
        latency_max_s=latency_s,
    )


def test_what_a_node_hears_of_an_action_is_one_row_with_the_sums_and_the_worst_latency() -> None:
    send = "/arm/move/_action/send_goal/carrier/move/_action/send_goal"
    found = actions_as_one(
        [
            row("/arm/pose", "/carrier", 7, 0.1, 1.0),
            row("/arm/move/_action/feedback", "/carrier", 20, 0.2, 20.0),
            row("/arm/move/_action/status", "/carrier", 3, None, None),
            row(send, "/carrier", 1, 0.5, 0.0),
            row("/carrier/move/_action/send_goal", "/arm", 1, 0.3, 0.0),
        ]
    )
    assert [(one.topic, one.reader, one.received, one.lost) for one in found] == [
        ("/arm/pose", "/carrier", 7, 1),
        ("/arm/move", "/carrier", 24, 3),
        ("/carrier/move", "/arm", 1, 1),
    ]
    assert (found[1].rate_hz, found[1].latency_max_s) == (20.0, 0.5)
