"""What ``hz``, ``bw`` and ``delay`` share: a window over a publisher's numbers, and the readers' accounts."""

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from palp_core.cli.output import note
from palp_core.cli.running import note_ended
from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import Edge, RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.topic import Topic

REPORT_NS = 1_000_000_000
COUNTS = ("received", "lost", "repeated", "late", "dropped", "filled")
ASK_S = 2.0


class _Point(NamedTuple):
    sequence: int
    stamp_ns: int
    arrived_ns: int
    size_bytes: int


class Window:
    """The last messages of one publisher; a restarted one begins anew.

    Sequence and stamp are the publisher's, so what this process misses or when it wakes does not count.

    Args:
        length: Messages to keep.
    """

    def __init__(self, length: int) -> None:
        self._points: deque[_Point] = deque(maxlen=length + 1)
        self._epoch = -1
        self.lost = 0
        self.heard_ns = monotonic_ns()
        self.fresh = 0

    def add(self, heard: ReceivedFrame) -> None:
        """Take a message, or what a heartbeat revealed."""
        self.lost += heard.lost
        if not heard.is_message:
            return
        frame = heard.frame
        if frame.epoch != self._epoch:
            self._points.clear()
            self._epoch, self.lost = frame.epoch, 0
        self._points.append(_Point(frame.sequence, frame.stamp_ns, heard.arrived_ns, heard.size_bytes))
        self.heard_ns = heard.arrived_ns
        self.fresh += 1

    @property
    def full(self) -> bool:
        """As many as asked for."""
        return len(self._points) == self._points.maxlen

    @property
    def messages(self) -> int:
        """Messages that the window spans, missed ones included."""
        return self._count + 1 if self._points else 0

    @property
    def _count(self) -> int:
        return self._points[-1].sequence - self._points[0].sequence

    def rates_hz(self) -> tuple[float | None, float | None]:
        """Return the rate on the graph's clock and on this machine's; None where no time has passed."""
        if len(self._points) < 2:
            return None, None
        first, last = self._points[0], self._points[-1]
        span_s = (last.stamp_ns - first.stamp_ns) / 1e9
        wall_s = (last.arrived_ns - first.arrived_ns) / 1e9
        return self._count / span_s if span_s else None, self._count / wall_s if wall_s else None

    def periods_s(self) -> dict[str, float | None]:
        """Return minimum, maximum and standard deviation of the time between neighbouring messages."""
        points = list(self._points)
        periods = [
            (b.stamp_ns - a.stamp_ns) / 1e9
            for a, b in itertools.pairwise(points)
            if b.sequence == a.sequence + 1
        ]
        if not periods:
            return {"min_period_s": None, "max_period_s": None, "std_period_s": None}
        mean = math.fsum(periods) / len(periods)
        variance = math.fsum((period - mean) ** 2 for period in periods) / len(periods)
        return {
            "min_period_s": min(periods),
            "max_period_s": max(periods),
            "std_period_s": math.sqrt(variance),
        }

    def sizes_bytes(self) -> list[int]:
        """Return the size of each message on the wire."""
        return [point.size_bytes for point in self._points]


def measure(
    graph: RunningGraph,
    topics: Sequence[Topic],
    windows: dict[str, Window],
    report: Callable[[], None],
    *,
    once: bool,
    timeout_s: float,
) -> None:
    """Fill windows; report each second, or once when all are full or the time is over.

    Raises:
        GraphError: ``once``, and a topic had fewer than two messages.
    """
    end_ns = monotonic_ns() + round(timeout_s * 1e9)
    next_ns = monotonic_ns() + REPORT_NS
    with TopicReader(graph, topics) as listener:
        for heard in listener.messages():
            if heard is not None:
                windows[heard.frame.topic].add(heard)
            now_ns = monotonic_ns()
            if once and (all(w.full for w in windows.values()) or now_ns > end_ns):
                break
            if not once and now_ns >= next_ns:
                next_ns += REPORT_NS * ((now_ns - next_ns) // REPORT_NS + 1)
                _note_silence(listener, windows, now_ns)
                report()
                for window in windows.values():
                    window.fresh = 0
    if once:
        for name, window in windows.items():
            if window.rates_hz() == (None, None):
                count = listener.last_sequence.get(name, 0)
                raise GraphError(
                    f"{name}: fewer than two messages within {timeout_s:g} s ({count} published so far); "
                    "give it more time with --timeout S"
                )
        report()
    elif listener.ended:
        note_ended(graph)


def _note_silence(listener: TopicReader, windows: dict[str, Window], now_ns: int) -> None:
    for name, window in windows.items():
        if not window.fresh:
            silent_s = (now_ns - window.heard_ns) / 1e9
            count = listener.last_sequence.get(name)
            known = "its publisher does not answer" if count is None else f"{count} published so far"
            note(f"{name}: no new message for {silent_s:.0f} s ({known})")


def readers(graph: RunningGraph, topics: Iterable[Topic], window: int = 0) -> dict[str, list[Edge]]:
    """Ask the nodes for the accounts of who reads each topic, and the latencies of the last messages."""
    answers = graph.ask_all("info", timeout_s=ASK_S, window=window)
    return {topic.name: answers.edges(topic.name) for topic in topics}


def account(edge: Edge) -> dict[str, Any]:
    """Return a reader's account for machines."""
    names = ("port", *COUNTS, "rate_hz", "latency_s")
    return {"node": f"/{edge.node}", **{name: edge.account.get(name) for name in names}}


def reader_lines(edges: Iterable[Edge]) -> list[str]:
    """Return the readers' accounts in words."""
    lines = []
    for edge in edges:
        counts = ", ".join(f"{edge.account[name]} {name}" for name in COUNTS if name in edge.account)
        rate_hz = edge.account.get("rate_hz")
        rate = "" if rate_hz is None else f", {rate_hz:.3f} Hz"
        lines.append(f"\treader /{edge.node}: {counts}{rate}")
    return lines
