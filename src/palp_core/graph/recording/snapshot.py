"""A recorder that keeps the last seconds in memory and writes them into a bag when somebody asks."""

from collections import deque
from collections.abc import Iterable
from typing import Any

from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.discovery.graph_reader import KIND_OFFSET
from palp_core.graph.messages.frame import Kind
from palp_core.graph.messages.topic import Topic


class SnapshotRecorder(BagRecorder):
    """Accounts for every frame, and keeps it for a while; the last message of a latched topic for good."""

    def __init__(self, duration_ns: int, topics: Iterable[Topic]) -> None:
        writer: Any = _NoBag()
        topics = list(topics)
        super().__init__(writer, topics, from_start=False)
        self._duration_ns = duration_ns
        self._frames: deque[tuple[int, bytes]] = deque()
        self._latched_topics = frozenset(topic.name.encode() for topic in topics if topic.latched_depth)
        self._latched: dict[bytes, tuple[int, bytes]] = {}

    def describe(self, topic: Topic) -> None:
        super().describe(topic)
        if topic.latched_depth:
            self._latched_topics |= {topic.name.encode()}

    def expect_from(self, topic: str, epoch: int, first: int) -> None:
        """Nothing is expected of what was before."""

    def __call__(self, now_ns: int, frame: bytes) -> None:
        """Keep a frame and forget those that are too old."""
        super().__call__(now_ns, frame)
        kind = frame.find(0) + KIND_OFFSET
        if kind < len(frame) and frame[kind] == Kind.DATA:
            self._frames.append((now_ns, frame))
        while self._frames and self._frames[0][0] < now_ns - self._duration_ns:
            old = self._frames.popleft()
            topic = old[1].partition(b"\0")[0]
            if topic in self._latched_topics:
                self._latched[topic] = old

    def save(self, recorder: BagRecorder) -> None:
        """Give the frames to a recorder that does not expect sequence 1, the latched values first."""
        for now_ns, frame in [*sorted(self._latched.values()), *self._frames]:
            recorder(now_ns, frame)


class _NoBag:
    """In a writer's place: nothing is written yet."""

    def stream(self, *_: object) -> int:
        return 0

    def ignore(self, *_: object, **__: object) -> None:
        pass

    write = tick = attach = close = abandon = ignore
