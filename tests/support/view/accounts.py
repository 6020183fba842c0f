"""What a reader of a running graph has had, before and after something that it must not feel."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import TopicReader
from palp_core.graph.messages.builtin import GraphEvent
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from tests.support.palp import Palp

MESSAGES = 20


def running_graph(palp: Palp, name: str) -> RunningGraph:
    """Return a graph that was launched by this command line.

    Raises:
        GraphError: It does not run, or not yet.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
        return RunningGraph.find(name)


class Accounts:
    """The account that one node keeps of one topic, and what the launcher says of swaps.

    Args:
        palp: By whom the graph was launched.
        graph: Its name.
        node: The reader.
        topic: What it reads.
    """

    def __init__(self, palp: Palp, graph: str, node: str, topic: str) -> None:
        self.graph = running_graph(palp, graph)
        self._node, self._topic = node, topic

    @property
    def now(self) -> dict[str, Any]:
        """The account as it is."""
        inputs = self.graph.ask(self._node, "info")["inputs"]
        return dict(inputs[self._topic])

    def go_on(self) -> None:
        """Check that messages go on to come, and that none was lost."""
        before = int(self.now["received"])
        with TopicReader(self.graph, [self.graph.topic(self._topic)]) as reader:
            came = (sample for sample in reader.messages() if sample is not None and sample.is_message)
            for _ in range(MESSAGES):
                next(came)
            while (now := self.now)["received"] < before + MESSAGES:
                next(came)
        assert now["lost"] == 0

    @property
    def swapping(self) -> bool:
        """Whether the launcher is about a swap."""
        return bool(self.graph.ask("graph", "swap_progress")["node"])

    def swaps(self) -> list[str]:
        """Return what became of swaps, one after another."""
        reply = self.graph.ask("graph", "history", topic="/graph/events", first=1, last=2**62)
        events = [decode(GraphEvent, parse(frame).payload) for frame in reply["frames"]]
        return [f"{event.kind}: {event.text}" for event in events if event.kind in ("swapped", "swap_failed")]
