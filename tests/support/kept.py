"""What a checkpoint keeps of a node on a bench, and a bench on which another goes on from there."""

from __future__ import annotations

from typing import Any

from palp_core import Bench, Node
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.process.checkpoint import NodeCheckpointer, restore


class Kept:
    """A node as it was after its last message on a topic; it is looked at once a turn."""

    def __init__(self, bench: Bench[Any], topic: str) -> None:
        self.node = b""
        self._keeping = NodeCheckpointer(bench.executor, topic, self._keep)

    def turn(self) -> None:
        """Keep the node if it has published something on the topic."""
        self._keeping.turn()

    def _keep(self, _: int, node: bytes) -> None:
        self.node = node


def go_on(node: type[Node], params: dict[str, Any], kept: bytes) -> Bench[Any]:
    """Return a bench on which a node goes on from what was kept."""
    bench: Bench[Any] = Bench(node, params, active=False)
    bench.executor.transition(Transition.CONFIGURE)
    restore(bench.executor, kept)
    bench.executor.transition(Transition.ACTIVATE)
    return bench
