"""What has happened: from a bag, and what a page keeps of what nodes forget."""

from __future__ import annotations

from pathlib import Path

from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import DiagnosticStatus, GraphEvent, NodeEvent
from palp_core.graph.messages.message import Message
from palp_core.view.source.protocol import Sample
from palp_core.view.source.recorded import RecordedSource
from palp_core.view.source.timeline import TimelineEvent, latest_first, of_status, recorded
from tests.support.bags import describe, frame

SAID: list[tuple[str, Message]] = [
    ("/graph/events", GraphEvent(stamp_ns=1, kind="started", node="", text="2 nodes", data="")),
    ("/safety/diagnostics", DiagnosticStatus(stamp_ns=2)),
    ("/graph/events", GraphEvent(stamp_ns=3, kind="restarting", node="stage", text="it died", data="")),
    ("/stage/_events", NodeEvent(stamp_ns=4, kind="message_lost", text="2 messages lost", data="")),
    ("/safety/diagnostics", DiagnosticStatus(stamp_ns=5, level="error", text="tripped: operator")),
    ("/safety/diagnostics", DiagnosticStatus(stamp_ns=6)),
]


def test_a_bag_shows_what_happened_to_the_graph_and_to_its_nodes_and_their_state(tmp_path: Path) -> None:
    topics = [describe(type(message), name) for name, message in dict(SAID).items()]
    recorder = BagRecorder(BagWriter(tmp_path / "run"), topics)
    count = dict.fromkeys(dict(SAID), 0)
    for at_s, (name, message) in enumerate(SAID):
        count[name] += 1
        recorder(at_s, frame(name, message, count[name], at_s * 10**9))
    recorder.close()
    source = RecordedSource(tmp_path / "run")
    assert [(one.kind, one.node, one.level, one.text) for one in recorded(source)] == [
        ("well", "safety", "ok", "it is well again"),
        ("fault", "safety", "error", "tripped: operator"),
        ("message_lost", "stage", "warn", "2 messages lost"),
        ("restarting", "stage", "warn", "it died"),
        ("started", "", "ok", "2 nodes"),
    ]
    source.close()


def test_a_page_keeps_what_was_each_once_and_the_latest_first() -> None:
    fault, well = TimelineEvent(1.0, "fault", "a", "x", "error"), TimelineEvent(2.0, "well", "a", "y", "ok")
    assert latest_first([fault, well, fault]) == [well, fault]


def test_to_begin_well_is_no_news_and_an_unknown_level_is_a_warning() -> None:
    assert of_status("a", Sample(0, 1, {"level": "ok", "text": ""})) is None
    odd = of_status("a", Sample(0, 1, {"level": "purple", "text": "odd"}))
    assert odd == TimelineEvent(0.0, "warning", "a", "odd", "warn")
