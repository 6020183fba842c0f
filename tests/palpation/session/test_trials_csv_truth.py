from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from palp_core.palpation.session.trials_csv import read_rows

Writer = Callable[..., Path]


def test_what_nobody_told_is_read_back_as_unknown(record: Writer) -> None:
    assert {row.true_height_m for row in read_rows(record())} == {None}


def test_a_record_without_a_column_for_the_height_is_still_read(record: Writer) -> None:
    out = record()
    table = out / "trials.csv"
    lines = [line.split(",") for line in table.read_text().splitlines()]
    place = lines[0].index("true_height_m")
    table.write_text("".join(",".join([*cells[:place], *cells[place + 1 :]]) + "\n" for cells in lines))
    rows = read_rows(out)
    assert [row.true_height_m for row in rows] == [None] * len(rows)
    assert rows[0].true_ring_m == 0.0
