"""What every source has: a running graph, a bag."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol

import msgspec

from palp_core.errors import PalpError
from palp_core.graph.messages.topic import Topic
from palp_core.view.source.overview import Overview


class Sample(msgspec.Struct, frozen=True):
    """A message as plain values, arrays as lists; its time on the graph's clock, its place in its topic."""

    stamp_ns: int
    sequence: int
    message: dict[str, Any]


class Watch(Protocol):
    """A watched topic, until it is closed."""

    topic: Topic

    def latest(self) -> Sample | None:
        """Return the last message; None before the first."""

    def read_new(self) -> list[Sample]:
        """Return what has come since the last call, the oldest first; what is too much is left out."""

    @property
    def rate_hz(self) -> float | None:
        """Messages a second on the graph's clock, by the publisher's own numbers and stamps."""

    def close(self) -> None:
        """Stop watching."""


class ViewSource(Protocol):
    """What a page shows."""

    def overview(self) -> Overview:
        """Return all of it as it is now, without waiting."""

    def topics(self) -> list[Topic]:
        """Return what can be watched."""

    def watch(self, topic: str) -> Watch:
        """Look at a topic.

        Raises:
            PalpError: There is none of that name.
        """

    def history(self, topics: Sequence[str]) -> Iterator[tuple[str, Sample]]:
        """Yield what is remembered of some topics, the oldest first; it may wait: use it on a thread.

        Of a running graph that is what the publishers still have, of a bag all of it. What is of no topic of
        this source is left out.
        """

    def launch(self) -> dict[str, Any]:
        """Return the launch file, with ``args`` and ``params`` by node; {} if unknown."""

    def close(self) -> None:
        """Release everything."""


def open_watches(source: ViewSource, topics: Iterable[str]) -> dict[str, Watch]:
    """Return a watch of each topic by its name; one that is not there has none."""
    found = {}
    for topic in topics:
        with contextlib.suppress(PalpError):
            found[topic] = source.watch(topic)
    return found
