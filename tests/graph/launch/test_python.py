"""A graph from Python, as in a notebook."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.errors import GraphError, NodeError
from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.frame import parse
from tests.support.palp import CHAIN, own_workspace
from tests.support.rig_session import ComposedGraph

TOYS = """
from palp_core import Node, Params, every


class OnceParams(Params):
    rate_hz: float = 100.0


class Once(Node):
    params: OnceParams

    @every("rate_hz")
    def end(self):
        self.finish()


def report(summary):
    raise {}
"""
ONE = """
graph: one
clock: sim
report: {0}:report
nodes:
  once: {{run: {0}:Once, on_exit: shutdown}}
"""


def test_a_graph_runs_from_python_and_says_how_it_went() -> None:
    seen: list[tuple[int, str]] = []
    with Graph(
        CHAIN, clock="sim", count=20, observe=lambda now_ns, raw: seen.append((now_ns, parse(raw).topic))
    ) as graph:
        summary = graph.run()
    assert summary.exit_code == 0
    assert summary.clock_s == 0.2
    assert summary.args["count"] == 20
    assert summary.params["relay"] == {"gain": 2.0, "fail_at": -1}
    assert sum(topic == "/relay/amplified" for _, topic in seen) == 20
    assert [now_ns for now_ns, _ in seen] == sorted(now_ns for now_ns, _ in seen)


def test_a_graph_stops_at_a_time_on_its_clock() -> None:
    with own_workspace(), ComposedGraph(CHAIN, clock="sim", count=1000) as graph:
        summary = graph.run(until_s=0.5)
    assert summary.clock_s == 0.5


def test_a_failing_node_is_an_exception_that_names_it() -> None:
    with (
        pytest.raises(NodeError, match="block 3 is the one to fail at") as failure,
        own_workspace(),
        ComposedGraph(CHAIN, clock="sim", fail_at=3) as graph,
    ):
        graph.run()
    assert failure.value.node == "relay"


def test_mistakes_are_raised_before_anything_starts() -> None:
    with pytest.raises(GraphError, match=r"chain\.yaml"), Graph(CHAIN, count="many"):
        pass


@pytest.mark.parametrize(
    ("said", "raised"),
    [("ValueError: no ink", "ValueError('no ink')"), ("SystemExit: 0", "SystemExit(0)")],
)
def test_a_report_that_fails_is_said_and_the_run_counts_as_failed(
    tmp_path: Path, said: str, raised: str
) -> None:
    module = f"report_toys_{said[0].lower()}"
    (tmp_path / f"{module}.py").write_text(TOYS.format(raised))
    (tmp_path / "one.yaml").write_text(ONE.format(module))
    with ComposedGraph(tmp_path / "one.yaml") as graph:
        summary = graph.run()
    assert graph.summary == summary
    assert (summary.exit_code, summary.ended) == (1, "")
    assert summary.report == f"No report was written: {said}"
