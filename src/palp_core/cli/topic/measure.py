"""``palp topic hz``, ``bw`` and ``delay``: windows over a publisher's numbers, and the readers' accounts."""

from __future__ import annotations

import itertools
import statistics
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from threading import Event
from typing import Annotated, Any, NamedTuple

from palp_core.cli.options import Call, TopicsArgument, graph_verb, option
from palp_core.cli.output import note
from palp_core.cli.running import find_topics, note_ended, published_text
from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import Edge, RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.topic import Topic

OnceOption = Annotated[bool, option("One report: when the window is full.", "--once")]
LongestOption = Annotated[float, option("Longest time for one report.", "--timeout", metavar="S", min=0.0)]

REPORT_NS = 1_000_000_000
COUNTS = ("received", "lost", "repeated", "late", "dropped", "filled")
PERCENTILES = ("p50", "p90", "p99", "max")
ASK_S = 2.0
PERIOD_S = 1.0


class _Point(NamedTuple):
    sequence: int
    stamp_ns: int
    arrived_ns: int
    size_bytes: int


class Window:
    """The last messages of one publisher; a restarted one begins again.

    Sequence and stamp are the publisher's, so what this process misses or when it wakes does not count.
    """

    def __init__(self, length: int) -> None:
        self.points: deque[_Point] = deque(maxlen=length + 1)
        self._epoch = -1
        self.lost = 0
        self.received_ns = monotonic_ns()
        self.fresh = False

    def add(self, received: ReceivedFrame) -> None:
        """Take a message, or what a heartbeat revealed."""
        self.lost += received.lost
        if not received.is_message:
            return
        frame = received.frame
        if frame.epoch != self._epoch:
            self.points.clear()
            self._epoch, self.lost = frame.epoch, 0
        self.points.append(_Point(frame.sequence, frame.stamp_ns, received.arrived_ns, received.size_bytes))
        self.received_ns, self.fresh = received.arrived_ns, True

    @property
    def full(self) -> bool:
        return len(self.points) == self.points.maxlen

    @property
    def messages(self) -> int:
        return self.points[-1].sequence - self.points[0].sequence + 1 if self.points else 0

    def rates_hz(self) -> tuple[float | None, float | None]:
        """Return the rate on the graph's clock and on this machine's; None where no time has passed."""
        if len(self.points) < 2:
            return None, None
        first, last = self.points[0], self.points[-1]
        span_s, wall_s = (last.stamp_ns - first.stamp_ns) / 1e9, (last.arrived_ns - first.arrived_ns) / 1e9
        count = self.messages - 1
        return count / span_s if span_s else None, count / wall_s if wall_s else None

    def periods_s(self) -> dict[str, float | None]:
        """Return minimum, maximum and standard deviation of the time between neighbouring messages."""
        periods = [
            (b.stamp_ns - a.stamp_ns) / 1e9
            for a, b in itertools.pairwise(self.points)
            if b.sequence == a.sequence + 1
        ]
        low, high = min(periods, default=None), max(periods, default=None)
        spread = statistics.pstdev(periods) if periods else None
        return {"min_period_s": low, "max_period_s": high, "std_period_s": spread}


def _measure(
    call: Call,
    topics: Sequence[Topic],
    windows: dict[str, Window],
    report: Callable[[], None],
    *,
    once: bool,
    timeout_s: float,
) -> None:
    """Fill windows; report each second, or once when all are full or the time is over."""
    end_ns, next_ns = monotonic_ns() + round(timeout_s * 1e9), monotonic_ns() + REPORT_NS
    with TopicReader(call.graph, topics) as reader:
        for received in reader.messages():
            if received is not None:
                windows[received.frame.topic].add(received)
            now_ns = monotonic_ns()
            if once and (all(w.full for w in windows.values()) or now_ns > end_ns):
                break
            if not once and now_ns >= next_ns:
                next_ns += REPORT_NS * ((now_ns - next_ns) // REPORT_NS + 1)
                _note_silence(reader, windows, now_ns)
                report()
                for window in windows.values():
                    window.fresh = False
    if once:
        for name, window in windows.items():
            if window.rates_hz() == (None, None):
                raise GraphError(
                    f"{name}: fewer than two messages within {timeout_s:g} s "
                    f"({reader.last_sequence.get(name, 0)} published so far); "
                    "give it more time with --timeout S"
                )
        report()
    elif reader.ended:
        note_ended(call.graph)


def _note_silence(reader: TopicReader, windows: dict[str, Window], now_ns: int) -> None:
    for name, window in windows.items():
        if not window.fresh:
            silent_s = (now_ns - window.received_ns) / 1e9
            note(f"{name}: no new message for {silent_s:.0f} s ({published_text(reader, name)})")


def _readers(graph: RunningGraph, topics: Iterable[Topic], window: int = 0) -> dict[str, list[Edge]]:
    """Ask the nodes for the accounts of who reads each topic, and the latencies of the last messages."""
    answers = graph.ask_all("info", timeout_s=ASK_S, window=window)
    return {topic.name: answers.edges(topic.name) for topic in topics}


def _account(edge: Edge) -> dict[str, Any]:
    names = ("port", *COUNTS, "rate_hz", "latency_s")
    return {"node": f"/{edge.node}", **{name: edge.account.get(name) for name in names}}


def _reader_line(edge: Edge) -> str:
    counts = ", ".join(f"{edge.account[name]} {name}" for name in COUNTS if name in edge.account)
    rate_hz = edge.account.get("rate_hz")
    return f"\treader /{edge.node}: {counts}" + ("" if rate_hz is None else f", {rate_hz:.3f} Hz")


@graph_verb()
def hz(
    call: Call,
    topics: TopicsArgument,
    *,
    window: Annotated[
        int | None,
        option("Messages to measure; default: 10000, for one report 100.", "--window", "-w", min=1),
    ] = None,
    wall_time: Annotated[
        bool, option("The rate on this machine's clock, not the graph's.", "--wall-time")
    ] = False,
    once: OnceOption = False,
    timeout: LongestOption = 10.0,
) -> None:
    """Rate and periods come from the publisher's sequence numbers and stamps, so they are exact even if this
    process is slow. Each reader's counts follow. A report each second, or a single one with --once or
    --json.
    """
    clock = call.graph.record.clock
    once = once or call.as_json
    entries = find_topics(call.graph, topics)
    windows = {topic.name: Window(window or (100 if once else 10_000)) for topic in entries}

    def lines(head: str, found: Window, edges: list[Edge]) -> Iterator[str]:
        if found.messages < 2:
            return
        clock_hz, wall_hz = found.rates_hz()
        rate_hz = wall_hz if wall_time else clock_hz
        rate = f"average rate: {rate_hz:.3f}" if rate_hz else "no rate: all at one instant"
        pace = clock == "sim" and not wall_time and wall_hz
        yield head + rate + (f" ({wall_hz:.1f} Hz of wall time)" if pace else "")
        low, high, deviation = found.periods_s().values()
        if low is not None:
            yield f"\tmin: {low:.6f}s max: {high:.6f}s std dev: {deviation:.6f}s window: {found.messages}"
        yield from map(_reader_line, edges)
        if found.lost:
            yield f"\t{found.lost} did not reach this command; the rate counts them"

    def report() -> None:
        accounts = _readers(call.graph, entries)
        for name, found in windows.items():
            clock_hz, wall_hz = found.rates_hz()
            edges = accounts[name]
            result: dict[str, Any] = {"topic": name, "clock": clock, "hz": clock_hz, "wall_hz": wall_hz}
            result |= found.periods_s() | {"messages": found.messages, "lost": found.lost}
            result |= {"readers": [_account(edge) for edge in edges]}
            call.show(result, lines(f"{name}: " if len(windows) > 1 else "", found, edges))

    _measure(call, entries, windows, report, once=once, timeout_s=timeout)


@graph_verb()
def bw(
    call: Call,
    topics: TopicsArgument,
    *,
    window: Annotated[int, option("Messages to measure.", "--window", "-w", min=1)] = 100,
    once: OnceOption = False,
    timeout: LongestOption = 10.0,
) -> None:
    """It is the mean size on the wire, header included, times the rate by the publisher's own sequence
    numbers on this machine's clock, to each reader. A report each second, or a single one with --once or
    --json.
    """
    entries = find_topics(call.graph, topics)
    windows = {topic.name: Window(window) for topic in entries}

    def report() -> None:
        for name, found in windows.items():
            sizes = [point.size_bytes for point in found.points]
            if not sizes:
                continue
            mean = sum(sizes) / len(sizes)
            clock_hz, wall_hz = found.rates_hz()
            head = f"{name}: " if len(windows) > 1 else ""
            rate = "no rate yet" if wall_hz is None else f"{_size(mean * wall_hz)}/s"
            call.show(
                {
                    "topic": name,
                    "bytes_per_s": None if wall_hz is None else mean * wall_hz,
                    "bytes_per_clock_s": None if clock_hz is None else mean * clock_hz,
                    "mean_bytes": mean,
                    "min_bytes": min(sizes),
                    "max_bytes": max(sizes),
                    "messages": found.messages,
                    "lost": found.lost,
                },
                [
                    f"{head}{rate} from {counted(found.messages, 'message')}",
                    f"\tMessage size mean: {_size(mean)} min: {_size(min(sizes))} max: {_size(max(sizes))}",
                ],
            )

    _measure(call, entries, windows, report, once=once or call.as_json, timeout_s=timeout)


def _size(count: float) -> str:
    for unit, scale in (("MB", 1e6), ("KB", 1e3)):
        if count >= scale:
            return f"{count / scale:.2f} {unit}"
    return f"{count:.0f} B"


@graph_verb()
def delay(
    call: Call,
    topics: TopicsArgument,
    *,
    window: Annotated[
        int | None,
        option("Only each reader's last N; default: all.", "--window", "-w", metavar="N", min=1, max=10000),
    ] = None,
    once: Annotated[bool, option("One report, then end.", "--once")] = False,
) -> None:
    """From the publisher's stamp to arrival, of every message since the reader began, or with -w of its last
    N: nothing is sampled, and this command is not in the way. A report each second, or a single one with
    --once or --json.
    """
    graph = call.graph
    entries = find_topics(graph, topics)
    while True:
        for name, edges in _readers(graph, entries, window or 0).items():
            record = {"topic": name, "clock": graph.record.clock, "readers": [_latency(e) for e in edges]}
            call.show(record, (f"{name} -> /{e.node}: {_latency_text(e.account)}" for e in edges))
            if not edges and not call.as_json:
                note(f"{name}: no node reads it, so its latency is not counted")
        if once or call.as_json:
            return
        Event().wait(PERIOD_S)
        if not graph.alive:
            note_ended(graph)
            return


def _latency_s(account: dict[str, Any]) -> dict[str, Any] | None:
    """Return the latencies that were asked for, and of how many messages they are; None: there are none."""
    recent = account.get("recent_latency_s")
    if recent is not None:
        return recent if recent["messages"] else None
    latency_s = account.get("latency_s")
    return {"messages": account["received"], **latency_s} if latency_s else None


def _latency(edge: Edge) -> dict[str, Any]:
    latency_s = dict(_latency_s(edge.account) or {"messages": 0, **dict.fromkeys(PERCENTILES)})
    counts = {"received": edge.account["received"], "messages": latency_s.pop("messages")}
    return {"node": f"/{edge.node}", **counts, "latency_s": latency_s}


def _latency_text(account: dict[str, Any]) -> str:
    latency_s = _latency_s(account)
    if latency_s is None:
        count = account["received"]
        return f"{counted(count, 'message')}, all at one simulated instant" if count else "no message yet"
    recent = "std" in latency_s
    names = (*PERCENTILES, *(("mean", "std", "min") if recent else ()))
    text = " ".join(f"{name} {latency_s[name] * 1e3:.3f} ms" for name in names)
    return f"{text} of {'the last ' if recent else ''}{counted(latency_s['messages'], 'message')}"
