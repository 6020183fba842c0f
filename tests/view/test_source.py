"""What a page shows, without any page: series, messages, logs, what is wrong."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palp_core.errors import GraphError
from palp_core.graph.discovery.health import EdgeRow, NodeRow
from palp_core.graph.discovery.troubles import loss_troubles, node_troubles, worst
from palp_core.view.source.live import node_state, swaps_named
from palp_core.view.source.message_lines import MOST_LINES, tree_text
from palp_core.view.source.protocol import Sample
from palp_core.view.source.series import FieldSeries, number_fields, thinned

pytest.importorskip("nicegui")

from palp_core.view.pages.node import MOST_BYTES, NodeLog

NUMBER = {"type": "number", "x-unit": "N m"}
ARRAY = {"type": "string", "x-dtype": "<f8", "x-unit": "N m"}
BLOCK: dict[str, Any] = {
    "properties": {
        "start_ns": {"type": "integer"},
        "rate_hz": {"type": "number"},
        "torque_n_m": ARRAY,
        "name": {"type": "string"},
        "inner": {
            "type": "object",
            "properties": {"peak": NUMBER, "words": {"type": "array", "items": {"type": "string"}}},
        },
    }
}


def sample(stamp_s: float, **message: Any) -> Sample:
    return Sample(round(stamp_s * 1e9), 1, message)


def test_the_numbers_of_a_message_can_be_plotted_and_nothing_else() -> None:
    assert list(number_fields(BLOCK)) == ["start_ns", "rate_hz", "torque_n_m", "inner.peak"]
    with pytest.raises(GraphError, match="holds no numbers"):
        FieldSeries("name", BLOCK)
    with pytest.raises(GraphError, match="did you mean 'torque_n_m'"):
        FieldSeries("torque_nm", BLOCK)


def test_a_block_that_does_not_go_on_from_the_one_before_begins_with_a_gap() -> None:
    series = FieldSeries("torque_n_m", BLOCK)

    def times_s(start_ms: int, sequence: int) -> list[float]:
        start_ns = start_ms * 1_000_000
        message = {"start_ns": start_ns, "rate_hz": 1000.0, "torque_n_m": [0.5, 0.25]}
        found = series.add(Sample(start_ns, sequence, message))
        return [time_s for time_s, value in found.tolist() if math.isnan(value)]

    assert times_s(1000, 1) == []
    assert times_s(1002, 2) == []
    assert times_s(1500, 3) == [1.5]
    assert times_s(1502, 5) == [1.502]  # message 4 is missing
    assert times_s(1504, 1) == []  # another takes over


def test_a_late_block_and_a_rare_number_go_on_until_something_is_missing() -> None:
    series = FieldSeries("torque_n_m", BLOCK)
    for number, (start_ms, gaps) in enumerate([(1000, 0), (1029, 0), (1060, 1)], 1):
        message = {"start_ns": start_ms * 1_000_000, "rate_hz": 1000.0, "torque_n_m": [0.5] * 20}
        assert np.isnan(series.add(Sample(0, number, message))).sum() == gaps
    rare, series = ((1.0, 1), (60.0, 2), (61.0, 4)), FieldSeries("inner.peak", BLOCK)
    found = [series.add(Sample(round(at * 1e9), number, {"inner": {"peak": at}})) for at, number in rare]
    assert [len(points) for points in found] == [1, 1, 2]


def test_samples_of_a_block_stand_at_their_times_and_others_are_spread_since_the_message_before() -> None:
    series = FieldSeries("torque_n_m", BLOCK)
    assert series.label == "torque_n_m [N m]"
    points = series.add(sample(9.0, start_ns=1_000_000_000, rate_hz=1000.0, torque_n_m=[0.5, 0.25]))
    assert points.tolist() == [[1.0, 0.5], [1.001, 0.25]]
    series = FieldSeries("torque_n_m", BLOCK)
    series.add(sample(1.0, torque_n_m=[0.0]))
    assert series.add(sample(2.0, torque_n_m=[1.0, 2.0])).tolist() == [[1.5, 1.0], [2.0, 2.0]]


def test_a_message_without_the_number_adds_no_point() -> None:
    messages: list[dict[str, Any]] = [{}, {"inner": {}}, {"inner": {"peak": math.nan}}, {"(not shown)": "x"}]
    for message in messages:
        assert not len(FieldSeries("inner.peak", BLOCK).add(sample(1.0, **message)))


def test_thinning_keeps_every_peak_and_the_order() -> None:
    points = np.column_stack((np.arange(10_000.0), np.zeros(10_000)))
    points[4321, 1], points[8765, 1] = 7.0, -7.0
    points[[5000, 5001], 1] = np.nan
    kept = thinned(points, 100)
    assert len(kept) <= 101
    assert {4321.0, 5000.0, 8765.0} <= set(kept[:, 0])
    assert np.isnan(kept[:, 1]).sum() == 1
    assert (np.diff(kept[:, 0]) > 0).all()


def test_a_message_is_a_tree_of_lines_with_units() -> None:
    message = {"torque_n_m": [0.5, 1.0], "inner": {"peak": 0.25, "words": ["a"]}, "name": "<b>x</b>"}
    assert tree_text(message, BLOCK).splitlines() == [
        "torque_n_m: [0.5, 1] (2) N m", "inner:", "  peak: 0.25 N m", "  words: [a] (1)", "name: <b>x</b>",
    ]  # fmt: skip


def test_a_huge_message_is_cut_and_says_so() -> None:
    wide = {f"f{i}": i for i in range(100_000)}
    lines = tree_text(wide, {}).splitlines()
    assert (len(lines), lines[-1]) == (MOST_LINES + 1, "... more")
    assert len(tree_text({"text": "x" * 10_000_000, "list": list(range(1_000_000))}, {})) < 2000


def log_of(tmp_path: Path) -> Path:
    (tmp_path / "log").mkdir()
    return tmp_path / "log/merged.log"


def test_a_nodes_lines_come_as_they_are_printed(tmp_path: Path) -> None:
    path = log_of(tmp_path)
    log = NodeLog(tmp_path, "relay")
    assert log.new_lines() == []
    path.write_text(
        "10:00 relay: [ERROR] [relay]: broken\n10:00 source: hello\n10:00 relay:  and", encoding="utf-8"
    )
    assert [(line.level, line.text) for line in log.new_lines()] == [("error", "[ERROR] [relay]: broken")]
    with path.open("a", encoding="utf-8") as file:
        file.write(" more\n10:01 relay: <script>alert(1)</script>\n")
    assert [line.text for line in log.new_lines()] == [" and more", "<script>alert(1)</script>"]
    assert log.new_lines() == []


def test_a_log_that_becomes_the_old_one_is_followed_and_a_storm_has_a_gap(tmp_path: Path) -> None:
    path = log_of(tmp_path)
    path.write_text("10:00 relay: one\n", encoding="utf-8")
    log = NodeLog(tmp_path, "relay")
    log.new_lines()
    path.rename(tmp_path / "log/merged.log.1")
    path.write_text("10:01 relay: two\n", encoding="utf-8")
    assert [line.text for line in log.new_lines()] == ["two"]
    with path.open("a", encoding="utf-8") as file:
        file.write("10:00 relay: storm\n" * 100_000)
    lines = log.new_lines()
    assert "left out" in lines[0].text
    assert len(lines) < MOST_BYTES / 10
    assert log.new_lines() == []


def node_row(**changed: Any) -> NodeRow:
    zero = dict.fromkeys(("cpu_percent", "memory_bytes", "lost", "overruns", "missed_deadlines"), 0)
    given = {"name": "/relay", "pid": 1, "state": "active", "responsive": True, "rate_hz": 100.0, **zero}
    return NodeRow(**{"latency_p99_s": None, **given, **changed})


def edge_row(**changed: Any) -> EdgeRow:
    counts = dict.fromkeys(("lost", "repeated", "late", "dropped"), 0)
    latencies = {"latency_p50_s": 1e-4, "latency_p99_s": 1e-3, "latency_max_s": 1e-2}
    given = {"topic": "/source/sample", "reader": "/relay", "rate_hz": 100.0, "received": 10}
    return EdgeRow(**{**given, **counts, **latencies, **changed})


def test_a_node_that_changes_hands_is_not_shown_as_silent() -> None:
    asked = list[str]()

    def ask(_: str, operation: str, **__: Any) -> dict[str, Any]:
        asked.append(operation)
        return {"node": "relay", "steps": []}

    graph: Any = SimpleNamespace(ask=ask)
    assert (swaps_named(graph, [node_row()]), asked) == ([node_row()], [])
    rows = swaps_named(graph, [node_row(state="inactive"), node_row(name="/sink", state="inactive")])
    assert ([row.state for row in rows], asked) == (["being swapped", "inactive"], ["swap_progress"])
    assert [trouble.where for trouble in node_troubles(rows, {})] == ["/sink"]


def test_what_is_wrong_is_reported_with_what_to_type() -> None:
    assert [*node_troubles([node_row()], {}), *loss_troubles([edge_row()])] == []
    assert node_state(node_row(), {"relay": "nodes.relay:Relay"}, [], {"relay"}).health == "ok"
    nodes = [node_row(), node_row(name="/sink", state="inactive"), node_row(name="/dead", responsive=False)]
    dead = node_troubles(nodes, {"dead": "its process 7 is gone"})
    troubles = [*dead, *loss_troubles([edge_row(lost=3)])]
    assert [(one.where, one.level, one.command) for one in troubles] == [
        ("/dead", "error", "palp logs dead"),
        ("/sink", "warn", "palp lifecycle list /sink"),
        ("/source/sample -> /relay", "warn", "palp topic info /source/sample"),
    ]
    assert worst(troubles) == "error"
    states = {row.name: node_state(row, {}, troubles, set()) for row in nodes}
    assert [states[name].health for name in ("/relay", "/sink", "/dead")] == ["warn", "warn", "error"]
    assert states["/relay"].why == "3 messages lost, 10 received"
    assert states["/dead"].lifecycle == "silent"
