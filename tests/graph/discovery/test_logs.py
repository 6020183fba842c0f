"""Lines of the merged log: which record each belongs to, and which of them one asks for."""

from __future__ import annotations

import logging
from datetime import datetime
from pathlib import Path

import pytest

from palp_core.cli.values import since
from palp_core.errors import PalpError
from palp_core.graph.discovery.logs import LineFilter, LineReader, all_lines
from palp_core.graph.log_format import MergedFormatter, NodeFormatter

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
