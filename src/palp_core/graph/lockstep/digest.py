"""A digest per topic: two runs that published the same bytes in the same order have the same digests."""

import hashlib
from typing import Any

from palp_core.graph.messages.frame import parse


class TopicDigest:
    """Observes frames and hashes each topic's sequence numbers, stamps and payloads."""

    def __init__(self) -> None:
        self._hashes: dict[str, Any] = {}
        self._counts: dict[str, int] = {}

    def __call__(self, now_ns: int, frame: bytes) -> None:
        parsed = parse(frame)
        if parsed.topic not in self._hashes:
            self._hashes[parsed.topic] = hashlib.sha256()
            self._counts[parsed.topic] = 0
        digest = self._hashes[parsed.topic]
        digest.update(
            parsed.sequence.to_bytes(8, "little") + parsed.stamp_ns.to_bytes(8, "little", signed=True)
        )
        digest.update(parsed.payload)
        self._counts[parsed.topic] += 1

    def result(self) -> dict[str, dict[str, Any]]:
        """Return count and SHA-256 per topic, sorted by topic."""
        return {
            topic: {"count": self._counts[topic], "sha256": self._hashes[topic].hexdigest()}
            for topic in sorted(self._hashes)
        }
