"""A node's process knows how it does."""

import os

import pytest

from palp_core import Bench, Node, Params, every
from palp_core.graph.latency import Latency
from palp_core.graph.messages.builtin import EdgeHealth, NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.process.health import PULSE_NS, HealthProbe


class Rate(Params):
    rate_hz: float = 10.0


class Ticker(Node):
    params: Rate

    @every("rate_hz")
    def tick(self) -> None: ...


def health(probe: HealthProbe, **counts: int) -> NodeHealth:
    return decode(NodeHealth, probe.pulse(probe.due_ns, "active", {}, **counts))


def test_a_tick_that_starts_after_the_next_is_due_is_an_overrun() -> None:
    bench = Bench(Ticker, {"rate_hz": 10.0})
    for now_s in (0.1, 0.2, 0.45, 0.5):
        bench.clock.set(round(now_s * 1e9))
        bench.executor.run_timers()
    counts = {"ticks": 4, "overruns": 1, "missed_deadlines": 0, "lost_by_readers": 0}
    assert bench.executor.ends.counts() == counts


def test_it_says_whose_process_it_is_and_what_it_uses() -> None:
    probe = HealthProbe("a")
    said = health(probe, missed_deadlines=1, rejected=2, unread=3)
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
