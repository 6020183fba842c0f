"""Whoever looks on is told which step a swap has come to."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.swap.swap import STEPS, SwapFailed, SwapRequest
from palp_core.graph.swap.swapper import Swapper

IDLE = {"node": "", "step": "", "steps": STEPS}


class Host:
    """Notes what is told while it looks at the new class, and while it swaps."""

    def __init__(self) -> None:
        self.told: list[tuple[str, str]] = []
        self.swapper: Any = None

    def note(self) -> None:
        assert self.swapper is not None
        progress = self.swapper.progress()
        self.told.append((progress["node"], progress["step"]))

    def inspect_class(self, *_: Any) -> Any:
        self.note()
        for step in ("configure", "hand over"):
            self.swapper._current = SimpleNamespace(step=step)
            self.note()
        raise SwapFailed("relay", "hand over", "it would not")


def test_the_step_is_told_while_a_swap_is_under_way_and_none_before_and_after() -> None:
    nodes = [NodeSpec(name="relay", run="nodes.relay:Relay")]
    nothing: dict[str, Any] = {"args": {}, "readings": {}, "edges": {}, "topics": {}}
    checked = CheckedGraph(graph="toy", file="", workspace="", clock="sim", seed=0, nodes=nodes, **nothing)
    host: Any = Host()
    swapper = Swapper(checked, host, Path(), lambda: 0, lambda *_: None, lambda *_, **__: None)
    host.swapper = swapper
    assert swapper.progress() == IDLE
    with pytest.raises(SwapFailed):
        swapper.swap(SwapRequest(node="/relay", run="nodes.other:Other"))
    assert host.told == [("relay", "check"), ("relay", "configure"), ("relay", "hand over")]
    assert swapper.progress() == IDLE
