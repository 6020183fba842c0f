"""What nodes print is kept: as it is, merged with time and name, bounded, with the last words of a crash."""

from __future__ import annotations

import logging
import os
import re
import threading
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.cli.values import since
from palp_core.errors import PalpError
from palp_core.graph.discovery.logs import LineFilter, LineReader, all_lines, follow
from palp_core.graph.log_format import MergedFormatter, NodeFormatter
from palp_core.graph.supervision import logs
from palp_core.graph.supervision.logs import LogWriter, note, tail


def say(writer: LogWriter, path: Path, *pieces: bytes) -> None:
    """Let a process say something in pieces, and end."""
    read_end, write_end = writer.open(path.stem, path)
    for piece in pieces:
        os.write(write_end, piece)
        writer.read(read_end)
    os.close(write_end)
    writer.close(read_end)


def test_a_line_is_in_its_own_log_as_it_is_and_in_the_merged_one_with_time_and_name(tmp_path: Path) -> None:
    writer = LogWriter()
    say(writer, tmp_path / "a.log", b"one\ntw", b"o\n")
    say(writer, tmp_path / "b.log", b"the last wo")  # a line that was never ended is there all the same
    assert (tmp_path / "a.log").read_text() == "one\ntwo\n"
    assert (tmp_path / "b.log").read_text() == "the last wo\n"
    merged = (tmp_path / "merged.log").read_text().splitlines()
    assert [line.split(" ", 1)[1] for line in merged] == ["a: one", "a: two", "b: the last wo"]
    assert all(re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d ", line) for line in merged)


@settings(max_examples=30)
@given(st.lists(st.binary(min_size=1, max_size=200), max_size=20))
def test_whatever_is_printed_in_whatever_pieces_nothing_is_changed(
    tmp_path_factory: pytest.TempPathFactory, pieces: list[bytes]
) -> None:
    path = tmp_path_factory.mktemp("logs") / "a.log"
    say(LogWriter(), path, *pieces)
    said = b"".join(pieces)
    whole = said if not said or said.endswith(b"\n") else said + b"\n"
    assert path.read_bytes() == whole
    merged = path.with_name("merged.log").read_bytes()
    assert merged.count(b"\n") == whole.count(b"\n")


def test_logs_are_bounded_and_one_old_file_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "KEEP_BYTES", 1000)
    path = tmp_path / "a.log"
    say(LogWriter(), path, *(b"%08d\n" % number for number in range(1000)))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.log", "a.log.1", "merged.log", "merged.log.1"]
    assert all(p.stat().st_size <= 1000 for p in tmp_path.iterdir())
    kept = (tmp_path / "a.log.1").read_text() + path.read_text()
    numbers = [int(line) for line in kept.splitlines()]
    assert numbers == list(range(numbers[0], 1000))


def test_the_tail_reaches_into_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("three\nfour\n")
    Path(f"{path}.1").write_text("one\ntwo\n")
    assert tail(path, 3) == ["two", "three", "four"]
    assert tail(tmp_path / "none.log", 3) == []


def test_an_endless_line_is_merged_in_pieces(tmp_path: Path) -> None:
    say(LogWriter(), tmp_path / "a.log", *([b"x" * 50_000] * 3))
    assert max(map(len, (tmp_path / "merged.log").read_text().splitlines())) < 130_000
    assert (tmp_path / "a.log").stat().st_size == 150_001


def test_a_stray_child_that_prints_on_does_not_hold_the_end_of_a_log(tmp_path: Path) -> None:
    writer = LogWriter()
    read_end, write_end = writer.open("a", tmp_path / "a.log")
    os.write(write_end, b"said before the end\n")
    writer.close(read_end)  # the other end is still open
    os.close(write_end)
    assert (tmp_path / "a.log").read_text() == "said before the end\n"


def test_the_supervisors_notes_are_in_both(tmp_path: Path) -> None:
    note(tmp_path / "a.log", "WARNING", "gone")
    assert (tmp_path / "a.log").read_text() == "[WARNING] [supervisor]: gone\n"
    assert (tmp_path / "merged.log").read_text().endswith(" a: [WARNING] [supervisor]: gone\n")


def test_a_log_is_followed_through_its_change_of_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logs, "KEEP_BYTES", 1000)
    path = tmp_path / "a.log"
    path.write_text("before\n")
    lives = threading.Event()
    seen: list[str] = []
    arrived = threading.Semaphore(0)

    def read() -> None:
        lives.set()
        for line in follow(path, lives.is_set):
            seen.append(line)
            arrived.release()

    reader = threading.Thread(target=read)
    reader.start()
    lives.wait()
    writer = LogWriter()
    read_end, write_end = writer.open("a", path)
    while not arrived.acquire(timeout=0.05):  # until it looks
        os.write(write_end, b"hello\n")
        writer.read(read_end)
    for number in range(300):
        os.write(write_end, b"%08d\n" % number)
        writer.read(read_end)
        while f"{number:08d}" not in seen[-1]:
            arrived.acquire()
    lives.clear()
    os.write(write_end, b"end\n")
    writer.read(read_end)
    reader.join()
    os.close(write_end)
    writer.close(read_end)
    assert "before" not in seen
    assert [line for line in seen if line.isdigit()] == [f"{number:08d}" for number in range(300)]


def test_lines_that_a_full_disk_has_cost_are_counted_in_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = LogWriter()
    read_end, write_end = writer.open("a", tmp_path / "a.log")
    write, room = os.write, [5]

    def on_a_full_disk(descriptor: int, data: bytes) -> int:
        if descriptor == write_end:
            return write(descriptor, data)
        if room[0] == 0:
            raise OSError(28, "No space left on device")
        count = write(descriptor, data[: room[0]])
        room[0] -= count
        return count

    monkeypatch.setattr(os, "write", on_a_full_disk)
    monkeypatch.setattr(writer, "_merge", lambda *_: None)
    for line in (b"one\n", b"two\n", b"three\n"):
        os.write(write_end, line)
        writer.read(read_end)
    room[0] = 1000
    os.write(write_end, b"four\n")
    writer.read(read_end)
    os.close(write_end)
    writer.close(read_end)
    assert (tmp_path / "a.log").read_text() == "one\nt[9 bytes are lost here: the disk was full]\nfour\n"


AT = "2026-11-22T12:00:0{}.000+00:00"
LOG = [
    f"{AT.format(0)} stage: [INFO] [stage]: homed",
    f"{AT.format(1)} stage: [WARNING] [stage]: slow",
    f"{AT.format(1)} policy: printed",
    f"{AT.format(2)} stage:     by a second",
    f"{AT.format(3)} policy: [ERROR] [policy]: choose failed: ValueError: 13",
    f"{AT.format(3)} policy:     Traceback (most recent call last):",
    f"{AT.format(3)} policy:     ValueError: 13",
    f"{AT.format(4)} stage: printed",
    f"{AT.format(5)} torque: Exception in thread Thread-1 (read):",
    f"{AT.format(5)} torque: Traceback (most recent call last):",
    f'{AT.format(5)} torque:   File "torque.py", line 3, in read',
    f"{AT.format(6)} torque: OSError: gone",
    f"{AT.format(7)} torque: printed",
]


def test_a_line_is_of_its_record_whatever_others_print_between() -> None:
    reader = LineReader()
    read = [reader.read(line) for line in LOG]
    levels = ["info", "warning", "", "warning", *["error"] * 3, "", *["error"] * 4, ""]
    assert [line.level for line in read] == levels
    assert [i for i, line in enumerate(read) if line.begins] == [0, 1, 4, 8]
    assert (read[0].at, read[0].node, read[0].text) == (AT.format(0), "stage", "[INFO] [stage]: homed")


@pytest.mark.parametrize(
    ("sought", "expected"),
    [
        (LineFilter(), range(13)),
        (LineFilter(level="warning"), [1, 3, 4, 5, 6, 8, 9, 10, 11]),
        (LineFilter("stage"), [0, 1, 3, 7]),
        (LineFilter("stage", "warning"), [1, 3]),
        (LineFilter(level="error", since=datetime.fromisoformat(AT.format(5))), [8, 9, 10, 11]),
        (LineFilter(since=datetime.fromisoformat("2026-11-22T13:00:04+01:00")), range(7, 13)),
    ],
)
def test_one_gets_the_lines_that_one_asks_for(sought: LineFilter, expected: list[int]) -> None:
    assert [i for i, line in enumerate(LOG) if sought.passes(line)] == list(expected)


def test_a_line_that_was_cut_is_not_lost() -> None:
    assert LineFilter(since=datetime.fromisoformat(AT.format(0))).passes("half of a li")


def test_the_old_file_comes_first(tmp_path: Path) -> None:
    (tmp_path / "merged.log").write_text("two\n")
    (tmp_path / "merged.log.1").write_text("one\n")
    assert list(all_lines(tmp_path / "merged.log")) == ["one", "two"]
    assert list(all_lines(tmp_path / "none.log")) == []


def test_a_record_of_several_lines_is_one_to_who_reads_the_log() -> None:
    record = logging.LogRecord("palp.stage", logging.WARNING, "", 0, "one\ntwo", (), None)
    assert NodeFormatter("arm").format(record) == "[WARNING] [arm]: one\n    two"
    reader = LineReader()
    read = [reader.read(line) for line in MergedFormatter().format(record).split("\n")]
    assert [(line.node, line.level, line.begins) for line in read] == [
        ("stage", "warning", True),
        ("stage", "warning", False),
    ]


NO_TIMES = ["yesterday", "999999d", "9" * 400 + "s", "2026", "0001-01-01T00:00+14:00"]


@pytest.mark.parametrize("text", NO_TIMES)
def test_what_is_no_time_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(PalpError, match="is not a time; write 30s"):
        since(text)


def test_a_time_is_so_long_ago_or_written_out() -> None:
    assert (since("0s") - since("2h")).total_seconds() == pytest.approx(7200.0, abs=60.0)
    assert since("2026-01-31T14:30+02:00") == datetime.fromisoformat("2026-01-31T12:30+00:00")


def test_a_time_of_day_that_is_to_come_is_of_yesterday(monkeypatch: pytest.MonkeyPatch) -> None:
    noon = datetime(2026, 11, 22, 12).astimezone()
    monkeypatch.setattr("palp_core.cli.values.unix_ns", lambda: int(noon.timestamp()) * 10**9)
    assert since("12:00") == noon
    assert since("11:59").strftime("%d %H:%M") == "22 11:59"
    assert since("12:01").strftime("%d %H:%M") == "21 12:01"
