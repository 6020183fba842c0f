from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.compare_policies import compare
from palp_core.errors import PalpError
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.result import build, write_result

Writer = Callable[..., Path]
Summariser = Callable[..., RunSummary]


def written(out: Path, summary: RunSummary) -> Path:
    write_result(build(read_session(out), summary), out)
    return out


def cells(table: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "|" in line
    ]


def test_sessions_stand_side_by_side_in_the_order_given(record: Writer, summary: Summariser) -> None:
    one = record("one", trials=[(0, [[0.9, 0.1, 0.0]]), (1, [[0.9, 0.1, 0.0]])])
    described = summary(two := record("two", trials=[(2, [[0.0, 0.0, 1.0]])]))
    described.args["policy"] = "fixed"
    table = two / "trials.csv"
    table.write_text(table.read_text(encoding="utf-8").replace(",markov,", ",fixed,"), encoding="utf-8")
    described.params["policy"] = {"ring_mm": 16.0}
    head, _, first, second = cells(compare([written(one, summary(one)), written(two, described)]))
    assert head[3:8] == ["accuracy (95 %)", "2 mm", "4 mm", "8 mm", "probes"]
    assert first[:8] == ["markov", "3", "2", "50.0 (9.5 to 90.5)", "100.0", "0.0", "–", "1.0"]
    assert first[-1] == "+0.400"
    assert second[:3] == ["fixed, 16 mm", "3", "1"]
    assert second[-1] == "+0.000"


def test_a_session_without_trials_has_dashes(record: Writer, summary: Summariser) -> None:
    out = record()
    assert "–" in cells(compare([written(out, summary(out))]))[2]


def test_the_lines_of_the_table_are_equally_long(record: Writer, summary: Summariser) -> None:
    out = written(found := record(trials=[(0, [[0.9, 0.1, 0.0]])]), summary(found))
    assert len({len(line) for line in compare([out, out]).splitlines() if line.startswith("|")}) == 1


def test_a_folder_without_a_result_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="no result"):
        compare([tmp_path])
