"""How a node's process does: measured where the node's loop turns, at next to no cost."""

import os
from collections.abc import Callable, Mapping

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.latency import Latency
from palp_core.graph.messages.builtin import EdgeHealth, NodeHealth
from palp_core.graph.messages.message import encode
from palp_core.graph.node.sequence_account import SequenceAccount

PULSE_NS = 500_000_000
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


class HealthProbe:
    """Counts what the loop of a node's process goes through."""

    def __init__(self, node: str, now_ns: Callable[[], int] = monotonic_ns) -> None:
        self.due_ns = now_ns()  # of the next pulse, on the machine's monotonic clock
        self._node = node
        self._statm = os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)

    def pulse(
        self,
        now_ns: int,
        lifecycle: str,
        edges: Mapping[str, tuple[SequenceAccount, Latency | None]],
        *,
        ticks: int = 0,
        overruns: int = 0,
        missed_deadlines: int = 0,
        lost_by_readers: int = 0,
        rejected: int = 0,
        unread: int = 0,
    ) -> bytes:
        """Return the encoded :class:`NodeHealth` for a pulse, and move :attr:`due_ns` on."""
        self.due_ns = now_ns + PULSE_NS
        times = os.times()
        return encode(
            NodeHealth(
                node=self._node,
                pid=os.getpid(),
                lifecycle=lifecycle,
                memory_bytes=self._memory_bytes(),
                cpu_s=times.user + times.system,
                tick_count=ticks,
                overrun_count=overruns,
                missed_deadline_count=missed_deadlines,
                rejected_count=rejected,
                unread_count=unread,
                lost_by_readers_count=lost_by_readers,
                counted_ns=now_ns,
                edges=[_edge(topic, counter, latency) for topic, (counter, latency) in edges.items()],
            )
        )

    def _memory_bytes(self) -> int:
        return int(os.pread(self._statm, 128, 0).split()[1]) * _PAGE_BYTES

    def close(self) -> None:
        if self._statm >= 0:
            os.close(self._statm)
            self._statm = -1


def _edge(topic: str, counter: SequenceAccount, latency: Latency | None) -> EdgeHealth:
    summary_s = latency.summary_s() if latency is not None else {}
    return EdgeHealth(
        topic=topic,
        received_count=counter.received,
        lost_count=counter.lost,
        repeated_count=counter.repeated,
        late_count=counter.late,
        dropped_count=counter.dropped,
        latency_p50_s=summary_s.get("p50", 0.0),
        latency_p90_s=summary_s.get("p90", 0.0),
        latency_p99_s=summary_s.get("p99", 0.0),
        latency_max_s=summary_s.get("max", 0.0),
    )
