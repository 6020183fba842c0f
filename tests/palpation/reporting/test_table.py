from pathlib import Path

from palp_core.palpation.reporting.table import write_csv, write_records


def test_a_table_has_its_heading_and_an_empty_cell_for_nothing(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", ("name", "x, mm"), [("a, b", 1.5), ("c", None)])
    assert (tmp_path / "a.csv").read_bytes() == b'name,"x, mm"\n"a, b",1.5\nc,\n'
    write_records(tmp_path / "b.csv", [{"x": 1, "y": None}, {"x": float("nan"), "y": "z"}])
    assert (tmp_path / "b.csv").read_bytes() == b"x,y\n1,\nnan,z\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "b.csv"]
