"""Keep the last seconds in memory and write them only when somebody asks."""

from collections import deque
from collections.abc import Collection

from palp_core.errors import SchemaMismatch
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.messages.frame import Kind, parse


class FrameHistory:
    """An observer that remembers frames for a while; latched values it remembers for good.

    Args:
        duration_ns: How far back, on the graph's clock.
        latched: Topics whose last message is kept however old it is.
    """

    def __init__(self, duration_ns: int, latched: Collection[str] = ()) -> None:
        self._duration_ns = duration_ns
        self._frames: deque[tuple[int, bytes]] = deque()
        self._latched_topics = frozenset(name.encode() for name in latched)
        self._latched: dict[bytes, tuple[int, bytes]] = {}

    def __call__(self, now_ns: int, frame: bytes) -> None:
        """Remember a frame and forget what is too old."""
        self._frames.append((now_ns, frame))
        while self._frames[0][0] < now_ns - self._duration_ns:
            old = self._frames.popleft()
            topic = old[1].partition(b"\0")[0]
            if topic in self._latched_topics and _is_data(old[1]):
                self._latched[topic] = old

    def save(self, recorder: BagRecorder) -> int:
        """Give a recorder what is remembered, the latched values first, and return how many frames.

        The recorder should not expect sequence 1 (``from_start=False``).
        """
        frames = [*sorted(self._latched.values()), *self._frames]
        for now_ns, frame in frames:
            recorder(now_ns, frame)
        return len(frames)


def _is_data(frame: bytes) -> bool:
    try:
        return parse(frame).kind == Kind.DATA
    except SchemaMismatch:
        return False
