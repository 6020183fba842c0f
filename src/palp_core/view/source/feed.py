"""Topics of a running graph that somebody looks at: read as fast as they come, kept only as far as shown.

Each has a thread that takes every message off the wire, so that nothing waits at the publisher; what nobody
has asked for by then is let go. Messages are decoded when a page asks, not when they arrive.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import TopicReader
from palp_core.graph.messages.frame import Frame
from palp_core.graph.messages.message_text import decoded
from palp_core.graph.messages.topic import Topic
from palp_core.view.source.protocol import Heard

MOST_BYTES = 8 << 20
MOST_MESSAGES = 2_000
"""Of one topic between two looks of a page: a screen shows no more, and decoding them takes some 20 ms."""
BATCH_S = {"wall": 0.01, "sim": 0.1}
"""By the graph's clock: messages are taken off the wire so often at most, many at once if need be."""
LONGEST_MESSAGE = 1 << 20
"""Bytes; of a longer one it is only said that it came: a page would be as large."""
ASK_S = 1.0


class _Feed:
    """One topic and its thread; it ends when the last watch is closed."""

    def __init__(self, graph: RunningGraph, topic: Topic) -> None:
        self.topic = topic
        self._graph = graph
        self.watches: list[TopicWatch] = []
        self.lock = threading.Lock()
        self.last: Frame | None = None
        self._stop = threading.Event()
        threading.Thread(target=self._work, name=f"palp view: {topic.name}", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _work(self) -> None:
        batch_s = BATCH_S[self._graph.record.clock]
        with TopicReader(self._graph, [self.topic]) as reader:
            self._ask_last()
            begun_ns = monotonic_ns()
            for heard in reader.messages():
                if self._stop.is_set():
                    return
                if heard is None:  # all that was there has been taken
                    self._stop.wait(batch_s - (monotonic_ns() - begun_ns) / 1e9)
                    begun_ns = monotonic_ns()
                elif heard.is_message:
                    self._take(heard.frame)

    def _ask_last(self) -> None:
        """Ask the publisher for its last message, if it keeps one: a rare topic shows something at once."""
        with contextlib.suppress(GraphError):
            last = (
                self._graph.ask(self.topic.node, "info", timeout_s=ASK_S)
                .get("published", {})
                .get(self.topic.name, 0)
            )
            for frame in self._graph.history(
                self.topic.node, self.topic.name, first=last, last=last, timeout_s=ASK_S
            ):
                with self.lock:
                    self.last = self.last or frame

    def _take(self, frame: Frame) -> None:
        with self.lock:
            self.last = frame
            for watch in self.watches:
                watch.add(frame)


class TopicWatch:
    """What one page has yet to show of a topic."""

    def __init__(self, feed: _Feed, let_go: Callable[[TopicWatch], None]) -> None:
        self._feed, self._let_go = feed, let_go
        self.topic = feed.topic
        self._waiting: deque[Frame] = deque(maxlen=MOST_MESSAGES)
        self._bytes = 0
        self._wants_all = False
        self._first: tuple[int, int, int] | None = None
        self._rate_hz: float | None = None

    def add(self, frame: Frame) -> None:
        """Take a message; the feed holds its lock."""
        if not self._wants_all:
            return
        if len(self._waiting) == MOST_MESSAGES:
            self._bytes -= len(self._waiting[0].payload)
        self._waiting.append(frame)
        self._bytes += len(frame.payload)
        while self._bytes > MOST_BYTES and len(self._waiting) > 1:
            self._bytes -= len(self._waiting.popleft().payload)

    def latest(self) -> Heard | None:
        """Return the last message; None before the first."""
        with self._feed.lock:
            frame = self._feed.last
        self._count(frame)
        return None if frame is None else heard(frame, self.topic)

    def drain(self) -> list[Heard]:
        """Return what has come since the last call; from the first call on all is kept for the next."""
        with self._feed.lock:
            self._wants_all = True
            frames = list(self._waiting)
            self._waiting.clear()
            self._bytes = 0
        return [heard(frame, self.topic) for frame in frames]

    @property
    def rate_hz(self) -> float | None:
        """Messages a second on the graph's clock, over the last second or more."""
        return self._rate_hz

    def close(self) -> None:
        self._let_go(self)

    def _count(self, frame: Frame | None) -> None:
        if frame is None:
            return
        now = frame.epoch, frame.sequence, frame.stamp_ns
        first = self._first
        if first is None or first[0] != now[0] or now[2] < first[2]:
            self._first = now
        elif (span_ns := now[2] - first[2]) >= 1_000_000_000:
            self._rate_hz = (now[1] - first[1]) * 1e9 / span_ns
            self._first = now


class Feeds:
    """The topics of a graph that somebody looks at.

    Args:
        graph: The graph.
    """

    def __init__(self, graph: RunningGraph) -> None:
        self._graph = graph
        self._feeds: dict[str, _Feed] = {}

    def watch(self, topic: Topic) -> TopicWatch:
        feed = self._feeds.get(topic.name)
        if feed is None:
            feed = self._feeds[topic.name] = _Feed(self._graph, topic)
        found = TopicWatch(feed, self._let_go)
        with feed.lock:
            feed.watches.append(found)
        return found

    def close(self) -> None:
        for feed in self._feeds.values():
            feed.stop()
        self._feeds.clear()

    def _let_go(self, watch: TopicWatch) -> None:
        feed = self._feeds.get(watch.topic.name)
        if feed is None or watch not in feed.watches:
            return
        with feed.lock:
            feed.watches.remove(watch)
        if not feed.watches:
            feed.stop()
            del self._feeds[watch.topic.name]


def heard(frame: Frame, topic: Topic) -> Heard:
    """Return a message as plain values; what cannot be shown says why."""
    if len(frame.payload) > LONGEST_MESSAGE:
        message = {"(not shown)": f"{len(frame.payload)} bytes; palp topic echo {topic.name} shows all of it"}
    else:
        try:
            message = decoded(frame.payload, topic.json_schema)
        except GraphError as error:
            message = {"(not shown)": str(error)}
    return Heard(frame.stamp_ns, frame.sequence, message)
