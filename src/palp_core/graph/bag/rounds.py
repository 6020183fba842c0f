"""Find again the rounds in which a lockstep graph worked at one instant.

A bag has the messages of an instant in the order in which they were published, round by round and within a
round in graph order. A message that could be an answer to one of the same round belongs to the next one: so a
node that is driven by a played bag meets causes before effects, as it did when the bag was recorded.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import msgspec

from palp_core.graph.bag.info import attached
from palp_core.graph.bag.reader import Bag

NODES_ATTACHMENT = "palp/nodes.json"


class _RecordedNode(msgspec.Struct, frozen=True):
    """What of a recorded node's place in its graph matters here."""

    name: str
    inputs: dict[str, str] = {}
    requests: dict[str, list[str]] = {}


class Rounds:
    """Says of each message in the order of the recording in which round of its instant it was published."""

    def __init__(self, nodes: Sequence[str] = (), reads: Mapping[str, Collection[str]] | None = None) -> None:
        self._place = {name: i for i, name in enumerate(nodes)}
        self._reads = {name: frozenset(topics) for name, topics in (reads or {}).items()}
        self._now_ns = -1
        self._round = 0
        self._last = -1
        self._topics: set[str] = set()

    @classmethod
    def of(cls, bag: Bag) -> Rounds:
        """Return the rounds of a bag; one that was recorded without its graph has one round per instant."""
        nodes = attached(bag.attachments(), NODES_ATTACHMENT, list[_RecordedNode])
        if nodes is None:
            return cls()
        reads = {}
        for node in nodes:
            replies = [f"{source}/{node.name}/{port}" for port, source in node.inputs.items()]
            requests = [topic for topics in node.requests.values() for topic in topics]
            reads[node.name] = {*node.inputs.values(), *replies, *requests}
        return cls([node.name for node in nodes], reads)

    def __call__(self, log_ns: int, topic: str) -> int:
        """Return the round of the next message, from 0."""
        node = topic.split("/")[1]
        place = self._place.get(node, -1)
        if log_ns != self._now_ns:
            self._now_ns, self._round = log_ns, 0
            self._topics = {topic}
        elif place < self._last or (place > self._last and self._topics & self._reads.get(node, frozenset())):
            self._round += 1
            self._topics = {topic}
        else:
            self._topics.add(topic)
        self._last = place
        return self._round
