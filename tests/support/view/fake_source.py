"""A source and an operator of pages that a test speaks for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import msgspec

from palp_core.graph.messages.topic import Topic
from palp_core.view.source.overview import Overview
from palp_core.view.source.protocol import Sample, Watch


class FakeWatch:
    rate_hz = None

    def __init__(self, samples: list[Sample], topic: Topic) -> None:
        self._samples, self.topic = samples, topic
        self._place = 0

    def latest(self) -> Sample | None:
        return self._samples[-1] if self._samples else None

    def read_new(self) -> list[Sample]:
        found, self._place = self._samples[self._place :], len(self._samples)
        return found

    def close(self) -> None:
        pass


class FakeSource:
    """A source whose nodes have published what :meth:`add` was given so far."""

    def __init__(self, now: Overview, topics: Iterable[Topic]) -> None:
        self.now, self._topics = now, list(topics)
        self.samples: dict[str, list[Sample]] = {topic.type: [] for topic in self._topics}
        self.launched: dict[str, Any] = {}

    def add(self, kind: str, stamp_ns: int, message: dict[str, Any]) -> None:
        """Publish a message on the topic of its type."""
        self.samples[kind].append(Sample(stamp_ns, len(self.samples[kind]) + 1, message))

    def change(self, **fields: Any) -> None:
        """Change what the overview says."""
        self.now = msgspec.structs.replace(self.now, **fields)

    def overview(self) -> Overview:
        return self.now

    def topics(self) -> list[Topic]:
        return self._topics

    def watch(self, topic: str) -> Watch:
        found = next(one for one in self._topics if one.name == topic)
        return FakeWatch(self.samples[found.type], found)

    def history(self, topics: Sequence[str]) -> Iterator[tuple[str, Sample]]:
        for topic in self._topics:
            if topic.name in topics:
                yield from ((topic.name, sample) for sample in self.samples[topic.type])

    def launch(self) -> dict[str, Any]:
        return self.launched

    def close(self) -> None:
        pass


class FakeOperator:
    """Notes calls of services, and replies as a test wants."""

    def __init__(self, **reply: Any) -> None:
        self.calls: list[tuple[str, str, dict[str, Any], bool]] = []
        self.reply, self.refused = reply, ""

    def refusal(self, *, stops: bool = False) -> str:
        return self.refused

    def call(
        self, node: str, service: str, request: dict[str, Any], *, stops: bool = False
    ) -> dict[str, Any]:
        self.calls.append((node, service, request, stops))
        return self.reply
