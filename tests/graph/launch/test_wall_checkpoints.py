"""What nodes write down on the machine's clock, where nobody may keep it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from palp_core.graph.launch.wall_checkpoints import WallCheckpoints


def test_of_a_blinded_run_nothing_is_written_down_and_it_goes_on() -> None:
    kept_by: Any = SimpleNamespace(path=None, write=pytest.fail)
    supervisor: Any = SimpleNamespace(on_kept=None)
    graph: Any = SimpleNamespace(spawned=[SimpleNamespace(name="node", keeps_at="/node/done")])
    nothing: Any = None
    WallCheckpoints(kept_by, lambda: graph, supervisor, nothing, nothing)
    supervisor.on_kept("node", 1, b"what it knows")
