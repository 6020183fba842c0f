"""How a node does: its process knows it, and rates are over its own time, whoever passes reports on when."""

from __future__ import annotations

import os
from typing import Any

import msgspec
import pytest

from palp_core import Bench, Node, Params, every
from palp_core.graph.discovery.health import EdgeRow, HealthSample, NodeRow, actions_as_one, rows
from palp_core.graph.latency import Latency
from palp_core.graph.messages.builtin import EdgeHealth, NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.process.health import PULSE_NS, HealthProbe
from tests.support.fake_graph import edge_health, health_of


class Rate(Params):
    rate_hz: float = 10.0


class Ticker(Node):
    params: Rate

    @every("rate_hz")
    def tick(self) -> None: ...


def test_a_tick_that_starts_after_the_next_is_due_is_an_overrun() -> None:
    bench = Bench(Ticker, {"rate_hz": 10.0})
    for now_s in (0.1, 0.2, 0.45, 0.5):
        bench.clock.set(round(now_s * 1e9))
        bench.executor.run_timers()
    counts = {"ticks": 4, "overruns": 1, "missed_deadlines": 0, "lost_by_readers": 0}
    assert bench.executor.ends.counts() == counts


def test_it_says_whose_process_it_is_and_what_it_uses() -> None:
    probe = HealthProbe("a")
    said = decode(NodeHealth, probe.pulse(0, "active", {}, missed_deadlines=1, rejected=2, unread=3))
    probe.close()
    assert (said.node, said.pid, said.lifecycle) == ("a", os.getpid(), "active")
    assert said.memory_bytes > 1_000_000
    assert said.cpu_s > 0.0
    assert (said.missed_deadline_count, said.rejected_count, said.unread_count) == (1, 2, 3)


def test_an_edge_is_reported_with_its_latencies() -> None:
    counter = SequenceAccount()
    counter.received, counter.lost, counter.repeated, counter.late, counter.dropped = 5, 4, 3, 2, 1
    latency = Latency()
    for milliseconds in range(1, 101):
        latency.add(milliseconds * 1_000_000)
    probe = HealthProbe("a")
    edges = {"/b/c": (counter, latency), "/b/d": (SequenceAccount(), None)}
    said = decode(NodeHealth, probe.pulse(0, "active", edges))
    probe.close()
    first, second = said.edges
    assert (first.topic, first.received_count, first.lost_count) == ("/b/c", 5, 4)
    assert (first.repeated_count, first.late_count, first.dropped_count) == (3, 2, 1)
    assert first.latency_p50_s == pytest.approx(0.05, rel=0.07)
    assert first.latency_p90_s <= first.latency_p99_s <= first.latency_max_s == 0.1
    assert isinstance(second, EdgeHealth)
    assert second.latency_max_s == 0.0


def test_pulses_are_half_a_second_apart_and_state_when_they_counted() -> None:
    probe = HealthProbe("a")
    now_ns = probe.due_ns + 7
    health = decode(NodeHealth, probe.pulse(now_ns, "active", {}))
    probe.close()
    assert (health.counted_ns, probe.due_ns) == (now_ns, now_ns + PULSE_NS)


S = 1_000_000_000
FIRST_NS = 500 * S


def health(counted_ns: int, received: int, cpu_s: float = 0.0, lifecycle: str = "active") -> NodeHealth:
    more: dict[str, Any] = {
        "cpu_s": cpu_s,
        "lifecycle": lifecycle,
        "tick_count": received,
        "counted_ns": counted_ns,
    }
    return health_of("sink", edge_health(received), pid=7, **more)


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
