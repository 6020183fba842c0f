"""Benches on which another node goes on: from a checkpoint, or where one hands over to it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from palp_core import Bench, Node
from palp_core.graph.messages.frame import parse
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


def replace(old: Bench[Any], node_class: type[Node] | None = None, **params: Any) -> Bench[Any]:
    """Return a bench on which another node continues where this one stands."""
    kept = old.executor.spec.params if node_class is None else {}
    new: Bench[Any] = Bench(node_class or type(old.node), {**kept, **params}, active=False)
    new.clock.set(old.clock.now_ns())
    new._sequence.update(old._sequence)
    new.executor.transition(Transition.CONFIGURE)
    new.executor.take_over(old.hand_over())
    return new


def require_each_row_once(out: Path, before: list[Any], read: Callable[[Path], list[Any]]) -> None:
    """Hold that a table has each row once: those of before its interruption, but for the trial set aside."""
    rows = read(out)
    cut = read(out / "interrupted" / "1") if (out / "interrupted").exists() else []
    assert [row.row for row in rows] == list(range(len(rows)))
    assert [row for row in before if row not in cut] == rows[: len(before) - len(cut)]
    assert len({row.trial for row in cut}) <= 1  # the one that had begun last


def sent_bytes(bench: Bench[Any]) -> list[bytes]:
    """Return every frame of the node's own outputs."""
    return [bytes(frame) for frame in bench.frames if not parse(frame).topic.endswith("/_order")]
