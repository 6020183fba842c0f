"""What nodes print is kept: as it is, merged with time and name, bounded, with the last words of a crash."""

from __future__ import annotations

import os
import re
import threading
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.discovery.logs import follow
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
