"""A bag and a folder of results as sources: at a chosen time, what is missing, and nothing outside."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from palp_core.errors import BagError, PalpError
from palp_core.view.pages.graph import wire_row, wire_words
from palp_core.view.source import recorded
from palp_core.view.source import results as results_module
from palp_core.view.source.overview import Overview
from palp_core.view.source.recorded import RecordedSource
from palp_core.view.source.results import ResultsSource
from tests.support.bags import bag, record, run_frames

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
    source.close()


def test_of_a_bags_wires_nothing_is_said_that_nobody_has_counted(bag: Path) -> None:
    source = RecordedSource(bag)
    source._launch = {"listens": {"estimator": ["/torque/block"]}}
    (wire,) = examined(source).wires
    assert (wire.received, wire.lost, wire.late, wire.dropped) == (None,) * 4
    assert wire_words(wire) == "/torque/block -> /estimator"
    assert wire_row(wire)[2:] == ("",) * 6
    source.close()


def test_a_plot_of_a_bag_goes_on_from_where_it_was(bag: Path) -> None:
    source = RecordedSource(bag)
    watch = source.watch("/torque/block")
    source.seek(0.010)
    assert [heard.sequence for heard in watch.drain()] == list(range(1, 12))
    assert watch.drain() == []
    source.seek(0.012)
    assert [heard.sequence for heard in watch.drain()] == [12, 13]
    source.seek(0.005)
    assert [heard.sequence for heard in watch.drain()] == list(range(1, 7))
    source.close()


def test_all_of_some_topics_is_remembered_whatever_the_chosen_time(bag: Path) -> None:
    source = RecordedSource(bag)
    found = list(source.remembered(["/policy/mode", "/torque/block", "/no/such"]))
    stamps = [heard.stamp_ns for _, heard in found]
    assert stamps == sorted(stamps)
    assert [heard.sequence for name, heard in found if name == "/torque/block"] == list(range(1, 201))
    assert {name for name, _ in found} == {"/policy/mode", "/torque/block"}


def test_before_the_begin_is_the_begin_and_after_the_end_the_end(bag: Path) -> None:
    source = RecordedSource(bag)
    source.seek(-5.0)
    assert source.at_s == 0.0
    source.seek(1e9)
    assert source.overview().now_s == 0.199


def test_what_plays_goes_on_as_the_clock_does_up_to_the_end_and_begins_anew(
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


def test_what_a_bag_lacks_is_said_with_its_place(tmp_path: Path) -> None:
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


def test_a_topic_that_a_bag_lacks_is_told_with_the_nearest(bag: Path) -> None:
    with pytest.raises(BagError, match="did you mean '/torque/block'"):
        RecordedSource(bag).watch("/torque/bloc")


def test_a_sealed_folder_shows_nothing_before_it_is_opened(tmp_path: Path) -> None:
    (tmp_path / "trials.csv").write_text("K7,decided", encoding="utf-8")
    (tmp_path / "key.sealed").write_text("sealed", encoding="utf-8")
    source = ResultsSource(tmp_path)
    assert (source.files(), source.path_of("trials.csv")) == ([], None)
    assert [one.level for one in source.overview().troubles] == ["warn"]
    (tmp_path / "key.json").write_text("{}", encoding="utf-8")
    assert [one.name for one in source.files()] == ["key.json", "trials.csv"]
    assert source.overview().troubles == []


OUTSIDE = [
    "../secret.txt", "../../etc/passwd", "/etc/passwd", "charts/../../secret.txt", "link.txt",
    "folder/secret.txt",    "a\0b.txt", "x" * 5000 + ".txt", "charts", ".", "", "program.sh",
]  # fmt: skip


@pytest.fixture
def results(tmp_path: Path) -> ResultsSource:
    folder = tmp_path / "results"
    (folder / "charts").mkdir(parents=True)
    (tmp_path / "secret.txt").write_text("secret", encoding="utf-8")
    for name in ("report.html", "trials.csv", "charts/a.png", "program.sh"):
        (folder / name).write_text(name, encoding="utf-8")
    (folder / "link.txt").symlink_to(tmp_path / "secret.txt")
    (folder / "folder").symlink_to(tmp_path)
    return ResultsSource(folder)


@pytest.mark.parametrize("name", OUTSIDE, ids=range(len(OUTSIDE)))
def test_nothing_outside_the_folder_is_given(name: str, results: ResultsSource) -> None:
    assert results.path_of(name) is None


def test_a_name_that_is_no_text_hides_only_itself(tmp_path: Path) -> None:
    (tmp_path / "trials.csv").touch()
    Path(os.fsdecode(bytes(tmp_path) + b"/a\xff.html")).touch()
    assert [file.name for file in ResultsSource(tmp_path).files()] == ["trials.csv"]


def test_a_disk_is_no_folder_of_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results_module, "MOST_BELOW", 3)
    for name in ("a/b", "c"):
        (tmp_path / name).mkdir(parents=True)
    assert ResultsSource(tmp_path).files() == []
    (tmp_path / "d").touch()
    with pytest.raises(PalpError, match="more than 3 files are below it; give the folder of one run"):
        ResultsSource(tmp_path)


def test_the_files_of_the_folder_are_listed_reports_first(results: ResultsSource) -> None:
    assert [file.name for file in results.files()] == ["report.html", "trials.csv", "charts/a.png"]
    for file in results.files():
        path = results.path_of(file.name)
        assert path is not None
        assert path.read_text(encoding="utf-8") == file.name


def test_what_is_neither_bag_nor_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="no such folder"):
        ResultsSource(tmp_path / "none")
