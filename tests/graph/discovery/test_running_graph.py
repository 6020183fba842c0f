"""A running graph as tools see it: how long a swap's answer is waited for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.node.spec import HUNG_S
from palp_core.graph.swap.swap import Probation


@pytest.mark.parametrize("clock", ["sim", "wall"])
def test_a_swap_is_waited_for_as_long_as_a_handler_on_probation_may_hang(
    clock: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited_s: list[float] = []

    def silent(_: str, __: dict[str, Any], timeout_s: float) -> None:
        waited_s.append(timeout_s)

    record = RunRecord("toy", "toy.yaml", clock, 1, 0, f"ipc://{tmp_path}/graph.srv", [], [])
    monkeypatch.setattr(RunningGraph, "alive", True)
    with pytest.raises(GraphError, match="did not answer"):
        RunningGraph(record, silent).swap("relay", "nodes:Other", timeout_s=10.0)
    assert sum(waited_s) >= 10.0 + 10.0 + HUNG_S[clock]  # the probation has the time-out once more
    assert Probation().longest_s is None
