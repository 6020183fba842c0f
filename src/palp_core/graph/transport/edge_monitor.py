"""How the edges into a node do on the wall clock: rates, latencies, publishers that have fallen silent."""

from collections.abc import Mapping
from typing import Any

from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.transport.reorder_buffer import ReorderBuffer

RATE_WINDOW_NS = 1_000_000_000


class EdgeMonitor:
    """Looks at every edge ten times a second."""

    def __init__(self, executor: Executor, buffers: Mapping[str, ReorderBuffer]) -> None:
        self._executor, self._buffers = executor, buffers
        self._silent: set[str] = set()
        self._rates = dict.fromkeys(buffers, (0, 0, 0.0))

    def look(self, now_ns: int, graph_ns: int) -> None:
        """Measure rates over whole seconds, and raise the liveliness events of the active node."""
        for name, buffer in self._buffers.items():
            count, since_ns, _ = self._rates[name]
            if now_ns - since_ns >= RATE_WINDOW_NS:
                rate_hz = (buffer.latency.count - count) / (now_ns - since_ns) * 1e9
                self._rates[name] = (buffer.latency.count, now_ns, rate_hz)
            if self._executor.lifecycle is Lifecycle.ACTIVE:
                for subscription in self._executor.ends.subscriptions[name]:
                    if subscription.qos.lease_ms:
                        self._look_for_silence(buffer, subscription, now_ns, graph_ns)

    def _look_for_silence(
        self, buffer: ReorderBuffer, subscription: Subscription, now_ns: int, graph_ns: int
    ) -> None:
        qos, port = subscription.qos, subscription.port
        asserted_ns = buffer.data_ns if qos.liveliness == "manual_by_topic" else buffer.heard_ns
        silent = now_ns - asserted_ns > qos.lease_ms * 1e6
        if silent != (port in self._silent):
            self._silent ^= {port}
            self._executor.ends.events["liveliness", port].count(1, graph_ns)

    def account(self, window: int = 0) -> dict[str, dict[str, Any]]:
        """Return what the node counts not itself; latencies of the last ``window`` messages if not 0."""
        return {
            name: {
                "filled": buffer.filled,
                "unread": buffer.unread,
                "rate_hz": self._rates[name][2],
                "latency_s": buffer.latency.summary_s() if buffer.latency.count else None,
                **({"recent_latency_s": buffer.latency.recent_s(window)} if window > 0 else {}),
            }
            for name, buffer in self._buffers.items()
        }
