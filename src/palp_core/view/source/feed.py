"""Watched topics of a running graph: read as fast as they come, kept only as far as shown.

A thread takes every message off the wire, so that nothing waits at the publisher, and drops what no page has
asked for. Messages are decoded when a page asks, not when they arrive.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from functools import partial

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.frame import Frame
from palp_core.graph.messages.message_text import decoded
from palp_core.graph.messages.topic import Topic
from palp_core.view.source.protocol import Sample

MOST_BYTES = 8 << 20
MOST_MESSAGES = 2_000
"""Of one topic between two looks of a page: a screen shows no more, and decoding them takes some 20 ms."""
BATCH_S = {"wall": 0.01, "sim": 0.1}
"""By the graph's clock: messages are taken off the wire so often at most, many at once if need be."""
SLICE_NS = 20_000_000
LONGEST_MESSAGE = 1 << 20
"""Bytes; of a longer one only the length is shown: a page would be as large."""
ASK_S = 1.0


class _Feed:
    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.watches: list[TopicWatch] = []
        self.lock = threading.Lock()
        self.last: Frame | None = None

    def ask_last(self, graph: RunningGraph) -> None:
        """Ask the publisher for its last message, if it keeps one: a rare topic shows something at once."""
        node, name = self.topic.node, self.topic.name
        with contextlib.suppress(GraphError):
            last = graph.ask(node, "info", timeout_s=ASK_S).get("published", {}).get(name, 0)
            for frame in graph.history(node, name, first=last, last=last, timeout_s=ASK_S):
                with self.lock:
                    self.last = self.last or frame

    def take(self, frame: Frame) -> None:
        with self.lock:
            self.last = frame
            for watch in self.watches:
                watch.add(frame)


class TopicWatch:
    """What one page has yet to show of a topic."""

    def __init__(self, feed: _Feed, release: Callable[[TopicWatch], None]) -> None:
        self._feed, self._release = feed, release
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

    def latest(self) -> Sample | None:
        with self._feed.lock:
            frame = self._feed.last
        self._count(frame)
        return None if frame is None else decode_sample(frame, self.topic)

    def read_new(self) -> list[Sample]:
        """Return what has come since the last call; from the first call on all is kept for the next."""
        with self._feed.lock:
            self._wants_all = True
            frames = list(self._waiting)
            self._waiting.clear()
            self._bytes = 0
        return [decode_sample(frame, self.topic) for frame in frames]

    @property
    def rate_hz(self) -> float | None:
        """Messages a second on the graph's clock, over the last second or more."""
        return self._rate_hz

    def close(self) -> None:
        self._release(self)

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
    """The watched topics of a graph, read on one thread while there are any."""

    def __init__(self, graph: RunningGraph) -> None:
        self._graph = graph
        self._lock = threading.Lock()
        self._feeds: dict[str, _Feed] = {}
        self._is_reading = False
        self._changed = threading.Event()

    def watch(self, topic: Topic) -> TopicWatch:
        with self._lock:
            feed = self._feeds.get(topic.name)
            if feed is None:
                feed = self._feeds[topic.name] = _Feed(topic)
            found = TopicWatch(feed, self._release)
            with feed.lock:
                feed.watches.append(found)
            if not self._is_reading:
                self._is_reading = True
                threading.Thread(target=self._work, name="palp view: topics", daemon=True).start()
        self._changed.set()
        return found

    def close(self) -> None:
        with self._lock:
            self._feeds.clear()
        self._changed.set()

    def _release(self, watch: TopicWatch) -> None:
        with self._lock:
            feed = self._feeds.get(watch.topic.name)
            if feed is None or watch not in feed.watches:
                return
            with feed.lock:
                feed.watches.remove(watch)
            if not feed.watches:
                del self._feeds[watch.topic.name]

    def _work(self) -> None:
        batch_s = BATCH_S[self._graph.record.clock]
        followed: dict[str, _Feed] = {}
        with TopicReader(self._graph, []) as reader:
            while True:
                begun_ns = monotonic_ns()
                with self._lock:
                    wanted = dict(self._feeds)
                    if reader.ended or not wanted:
                        self._is_reading = False
                        return
                reader.leave(name for name, feed in followed.items() if wanted.get(name) is not feed)
                new = [feed for name, feed in wanted.items() if followed.get(name) is not feed]
                reader.follow([feed.topic for feed in new])
                for feed in new:
                    threading.Thread(target=feed.ask_last, args=(self._graph,), daemon=True).start()
                followed = wanted
                reader.turn(partial(_hand_on, followed), SLICE_NS)
                self._changed.wait(batch_s - (monotonic_ns() - begun_ns) / 1e9)
                self._changed.clear()


def _hand_on(feeds: dict[str, _Feed], received: ReceivedFrame) -> None:
    if received.is_message:
        feeds[received.frame.topic].take(received.frame)


def decode_sample(frame: Frame, topic: Topic) -> Sample:
    """Return a message as plain values; one that cannot be shown holds the reason."""
    if len(frame.payload) > LONGEST_MESSAGE:
        message = {"(not shown)": f"{len(frame.payload)} bytes; palp topic echo {topic.name} shows all of it"}
    else:
        try:
            message = decoded(frame.payload, topic.json_schema)
        except GraphError as error:
            message = {"(not shown)": str(error)}
    return Sample(frame.stamp_ns, frame.sequence, message)
