"""What a node has done a second is counted over its own time, whoever passes its reports on at what pace."""

from __future__ import annotations

import msgspec
import pytest

from palp_core.graph.discovery.health import EdgeRow, HealthSample, NodeRow, actions_as_one, rows
from palp_core.graph.messages.builtin import EdgeHealth, NodeHealth

S = 1_000_000_000
FIRST_NS = 500 * S


def health(counted_ns: int, received: int, cpu_s: float = 0.0, lifecycle: str = "active") -> NodeHealth:
    edge = EdgeHealth(
        topic="/source/sample", received_count=received, lost_count=0, repeated_count=0, late_count=0,
        dropped_count=0, latency_p50_s=0.0, latency_p90_s=0.0, latency_p99_s=0.0, latency_max_s=0.0,
    )  # fmt: skip
    return NodeHealth(
        node="sink", pid=7, lifecycle=lifecycle, memory_bytes=1, cpu_s=cpu_s, tick_count=received,
        overrun_count=0, missed_deadline_count=0, rejected_count=0, unread_count=0, edges=[edge],
        counted_ns=counted_ns,
    )  # fmt: skip


def between(old: NodeHealth, new: NodeHealth) -> tuple[NodeRow, EdgeRow]:
    """Return the rows of two reports that came a second apart."""
    (node,), (edge,) = rows(HealthSample(3 * S, [old], {}), HealthSample(4 * S, [new], {}))
    return node, edge


def test_a_rate_is_over_the_time_between_a_nodes_own_counts_not_between_the_reports_receptions() -> None:
    first = health(FIRST_NS, 0)
    for took_ns in (S // 2, 1_120_000_000):  # one pulse, or two that came late
        count = took_ns // 10_000_000  # at 100 Hz
        node, edge = between(first, health(FIRST_NS + took_ns, count, cpu_s=took_ns / 4e9))
        found = node.rate_hz, edge.rate_hz, node.cpu_percent
        assert found == pytest.approx((200.0, 100.0, 25.0))  # ticks and messages; messages


def test_of_a_node_that_has_not_counted_anew_no_rate_is_told() -> None:
    said = health(FIRST_NS, 5)
    node, edge = between(said, said)
    assert (node.rate_hz, edge.rate_hz, node.cpu_percent) == (None, None, None)


def test_another_process_of_a_node_has_no_rate_yet() -> None:
    node, edge = between(health(FIRST_NS, 5), msgspec.structs.replace(health(FIRST_NS + S, 7), pid=8))
    assert (node.rate_hz, edge.rate_hz) == (None, None)


def row(topic: str, reader: str, received: int, latency_s: float | None, rate_hz: float | None) -> EdgeRow:
    latencies = dict.fromkeys(("latency_p50_s", "latency_p99_s", "latency_max_s"), latency_s)
    return EdgeRow(topic, reader, rate_hz, received, lost=1, repeated=0, late=0, dropped=0, **latencies)


def test_what_a_node_reads_of_an_action_is_one_row_with_the_sums_and_the_worst_latency() -> None:
    found = actions_as_one(
        [
            row("/arm/pose", "/carrier", 7, 0.1, 1.0),
            row("/arm/move/_action/feedback", "/carrier", 20, 0.2, 20.0),
            row("/arm/move/_action/status", "/carrier", 3, None, None),
            row("/arm/move/_action/send_goal/carrier/move/_action/send_goal", "/carrier", 1, 0.5, 0.0),
            row("/carrier/move/_action/send_goal", "/arm", 1, 0.3, 0.0),
        ]
    )
    assert [(one.topic, one.reader, one.received, one.lost) for one in found] == [
        ("/arm/pose", "/carrier", 7, 1), ("/arm/move", "/carrier", 24, 3), ("/carrier/move", "/arm", 1, 1),
    ]  # fmt: skip
    assert (found[1].rate_hz, found[1].latency_max_s) == (20.0, 0.5)


def test_a_node_that_did_not_answer_has_no_rate_before_and_after_but_its_host_knows_its_cpu_time() -> None:
    silent = health(0, 0, cpu_s=1.5, lifecycle="silent")
    node, edge = between(health(FIRST_NS, 500, cpu_s=1.0), silent)
    assert (node.rate_hz, edge.rate_hz, node.cpu_percent) == (None, None, 50.0)
    node, edge = between(silent, health(FIRST_NS + 2 * S, 700, cpu_s=1.6))
    assert (node.rate_hz, edge.rate_hz) == (None, None)
