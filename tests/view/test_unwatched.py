"""A viewer whose graph is gone ends when nobody looks at it any more, and not before."""

from __future__ import annotations

import pytest

from palp_core.view.server.unwatched import Unwatched
from tests.support.palp import CHAIN, PATIENCE_S, Palp, wait_for_line

S = 1_000_000_000


def test_it_is_unwatched_when_graph_and_browsers_are_gone_for_long_enough() -> None:
    over, connected = [False], [0]
    unwatched = Unwatched(lambda: over[0], lambda: connected[0], 60.0)
    assert not any(unwatched.is_so(at_s * S) for at_s in (0, 100))  # the graph runs
    over[0], connected[0] = True, 1
    assert not any(unwatched.is_so(at_s * S) for at_s in (200, 300))  # somebody reads how it ended
    connected[0] = 0
    assert [unwatched.is_so(at_s * S) for at_s in (400, 459)] == [False, False]
    connected[0] = 1  # a page was loaded again
    assert not unwatched.is_so(459 * S)
    connected[0] = 0
    assert [unwatched.is_so(at_s * S) for at_s in (470, 529, 530)] == [False, False, True]


def test_a_viewer_ends_after_its_graph_when_nobody_looks(palp: Palp) -> None:
    pytest.importorskip("nicegui")
    graph = palp.start("launch", CHAIN, "count:=1000000")
    wait_for_line(graph, "blocks: 1/")
    palp.constants["palp_core.view.server.unwatched:PATIENCE_S"] = 0.0
    palp.constants["palp_core.view.server.unwatched:LOOK_S"] = 0.05
    viewer = palp.start("view", "--no-browser")
    wait_for_line(viewer, "http://")
    assert palp.run("graph", "end").returncode == 0
    _, errors = viewer.communicate(timeout=PATIENCE_S)
    assert viewer.returncode == 0, errors
    assert "has ended, and nobody looks: the page is closed" in errors
    graph.communicate(timeout=PATIENCE_S)
