"""A bag as a source: at a chosen time, and what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.errors import BagError
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import DiagnosticStatus, GraphEvent, NodeEvent
from palp_core.graph.messages.message import Message
from palp_core.view.pages.graph import wire_row, wire_text
from palp_core.view.source import recorded
from palp_core.view.source.overview import Overview
from palp_core.view.source.protocol import Sample
from palp_core.view.source.recorded import RecordedSource
from palp_core.view.source.timeline import TimelineEvent, latest_first, of_status
from palp_core.view.source.timeline import recorded as happened
from tests.support.bags import bag, describe, frame, record, run_frames

__all__ = ["bag"]


def examined(source: RecordedSource) -> Overview:
    """Wait until the bag has been read as a whole."""
    source._examine()
    return source.overview()


def test_a_bag_shows_what_was_so_at_the_chosen_time(bag: Path) -> None:
    source = RecordedSource(bag)
    assert (source.start_s, source.end_s, source.at_s) == (0.0, 0.199, 0.199)
    block, mode = source.watch("/torque/block"), source.watch("/policy/mode")
    seen = []
    for at_s in (0.0, 0.05, 0.15, 0.05):
        source.seek(at_s)
        last, level = block.latest(), mode.latest()
        assert last is not None
        assert level is not None
        seen.append((last.sequence, last.message["counts"], level.message["level"]))
    assert seen == [(1, [0, 1], 0.5), (51, [50, 51], 0.5), (151, [150, 151], 1.5), (51, [50, 51], 0.5)]
    assert block.rate_hz == pytest.approx(1000.0)
    for at_s, shown_s in ((-5.0, 0.0), (1e9, 0.199)):
        source.seek(at_s)
        assert source.overview().now_s == shown_s
    with pytest.raises(BagError, match="did you mean '/torque/block'"):
        source.watch("/torque/bloc")
    source.close()


def test_a_bags_wires_have_no_counts_that_were_not_recorded(bag: Path) -> None:
    source = RecordedSource(bag)
    source._launch = {"listens": {"estimator": ["/torque/block"]}}
    (wire,) = examined(source).wires
    assert (wire.received, wire.lost, wire.late, wire.dropped) == (None,) * 4
    assert wire_text(wire) == "/torque/block -> /estimator"
    assert wire_row(wire)[2:] == ("",) * 6
    source.close()


def test_a_plot_of_a_bag_goes_on_from_where_it_was(bag: Path) -> None:
    source = RecordedSource(bag)
    watch = source.watch("/torque/block")
    source.seek(0.010)
    assert [sample.sequence for sample in watch.read_new()] == list(range(1, 12))
    assert watch.read_new() == []
    source.seek(0.012)
    assert [sample.sequence for sample in watch.read_new()] == [12, 13]
    source.seek(0.005)
    assert [sample.sequence for sample in watch.read_new()] == list(range(1, 7))
    source.close()


def test_all_of_some_topics_is_remembered_whatever_the_chosen_time(bag: Path) -> None:
    source = RecordedSource(bag)
    found = list(source.history(["/policy/mode", "/torque/block", "/no/such"]))
    stamps = [sample.stamp_ns for _, sample in found]
    assert stamps == sorted(stamps)
    assert [sample.sequence for name, sample in found if name == "/torque/block"] == list(range(1, 201))
    assert {name for name, _ in found} == {"/policy/mode", "/torque/block"}


def test_what_plays_goes_on_as_the_clock_does_up_to_the_end_and_begins_again(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = [0]
    monkeypatch.setattr(recorded, "monotonic_ns", lambda: now_ns[0])
    source = RecordedSource(bag)
    source.play()
    assert (source.playing, source.at_s) == (True, 0.0)
    now_ns[0] = 50_000_000
    assert (source.playing, source.at_s) == (True, 0.05)
    source.seek(0.15)
    now_ns[0] += 20_000_000
    assert source.overview().now_s == pytest.approx(0.17)
    source.play(on=False)
    now_ns[0] += 10**9
    assert source.at_s == pytest.approx(0.17)
    source.play()
    now_ns[0] += 10**9
    assert (source.at_s, source.playing) == (0.199, False)
    source.close()


def test_what_a_bag_lacks_is_reported_with_its_place(tmp_path: Path) -> None:
    frames = run_frames(50)
    whole, _ = record(tmp_path / "whole", frames)
    assert examined(RecordedSource(whole)).troubles == []
    path, _ = record(
        tmp_path / "gaps", [one for place, one in enumerate(frames) if place not in (10, 11, 12)]
    )
    (trouble,) = examined(RecordedSource(path)).troubles
    assert (trouble.where, trouble.level) == ("/torque/block", "warn")
    assert trouble.text == "3 messages are missing (10 to 12)"


def test_a_bag_that_was_cut_off_is_shown_as_far_as_it_goes(bag: Path) -> None:
    (file,) = bag.glob("*.mcap")
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    source = RecordedSource(file)
    source.seek(1e9)
    last = source.watch("/torque/block").latest()
    assert last is not None
    assert 10 < last.sequence < 200
    assert {trouble.level for trouble in examined(source).troubles} == {"error"}
    source.close()


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
    assert [(one.kind, one.node, one.level, one.text) for one in happened(source)] == [
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
