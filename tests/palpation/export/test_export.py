"""``palp session export``: what is written is what others read, cell by cell, in every format."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from scipy.io import loadmat
from typer.testing import CliRunner

from docs.site.dictionary_page import dictionary_page
from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.palpation.export.export import FORMS, Form, default_out, write_export
from palp_core.palpation.export.source import ExportSource, read_source
from palp_core.palpation.export.tables import (
    ExportColumn,
    ExportTable,
    columns_of,
    dictionary,
    emg_table,
    iterations_table,
    sweeps_table,
    trials_table,
)
from palp_core.palpation.identification.emg.files import Column, EmgFile
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.sheet.sheet import SIMULATED
from palp_core.palpation.session.trials_csv import Row, read_rows, read_sweep
from tests.support.palp import ROOT
from tests.support.rig_session import RigSession
from tests.support.sessions import writer

DEPTHS_M = (0.002, 0.0025, 0.008)
ODD = 'ångström µ ≥ 3 %, "x"; naïve 漢字 😀'
TRIALS = [(0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]), (1, [[0.8, 0.1, 0.1]]), (2, [[1 / 3, 1 / 3, 1 / 3]])]

Cells = dict[str, list[Any]]


def emg(count: int = 750) -> EmgFile:
    """EMG of a bag, with lost samples."""
    rng = np.random.default_rng(4)
    fds, edc = 1e-4 * rng.normal(size=(2, count))
    fds[100:175] = edc[100:175] = np.nan
    phases = {"rest": ((0, 100),), "mvc": ((175, 300),), "palpation": ((300, count),)}
    columns = (Column("fds_v", fds, "V", 1500.0), Column("edc_v", edc, "V", 1500.0))
    return EmgFile(Path("bag"), "bag", columns, phases, begin_s=2.5)


def odd_rows(folder: Path) -> list[Row]:
    """Rows with everything that a cell can be: no value, texts of all kinds, numbers of all sizes."""
    rows = read_rows(folder)
    replace = msgspec.structs.replace
    rows[0] = replace(rows[0], guards=[ODD, "second"], landed=None, true_ring_m=None, phantom="Ü")
    rows[1] = replace(rows[1], landed=True, peak_n_m=float("nan"), enter_ns=123456789, leave_ns=987654321)
    rows[2] = replace(rows[2], landed=False, peak_n_m=5e-324, guards=["NA", "nan", "None"], seed=2**53 + 1)
    rows[3] = replace(rows[3], peak_n_m=-1.7976931348623157e308, phantom="", start_ns=10**15 + 1)
    rows[-1] = replace(rows[-1], outlier=True, gamma=float("inf"))
    return rows


def source_of(folder: Path, rows: Sequence[Row], recorded: EmgFile | None) -> ExportSource:
    tables = (
        trials_table(rows, DEPTHS_M, ODD, {("estimation", 1001): ODD}),
        iterations_table(rows, DEPTHS_M, ODD),
        sweeps_table(folder, rows),
        emg_table(recorded),
    )
    run = {"graph": "rig", "launch_file": "sim.yaml", "seed": 1}
    return ExportSource(folder, {one.name: one for one in tables}, SIMULATED, run, ())


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> ExportSource:
    out = writer(tmp_path_factory.mktemp("export"))(depths_m=DEPTHS_M, trials=TRIALS)
    return source_of(out, odd_rows(out), emg())


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> ExportSource:
    return source_of(writer(tmp_path_factory.mktemp("empty"))(repeats=0, primitives=False), [], None)


def expected(table: ExportTable) -> Cells:
    """Return a table's cells as plain values; None where there is none."""
    return {
        one.name: [_plain(one, cell) for cell in table.values[one.name].tolist()] for one in table.columns
    }


def _plain(column: ExportColumn, cell: Any) -> Any:
    if column.kind == "flag":
        return None if cell == -1 else bool(cell)
    return None if column.kind == "number" and np.isnan(cell) else cell


def of_csv(path: Path, table: ExportTable) -> Cells:
    words = {"true": True, "false": False, "": None}
    read: dict[str, Callable[[str], Any]] = {
        "integer": int,
        "number": lambda cell: float(cell) if cell else None,
        "text": str,
        "flag": words.__getitem__,
    }
    with (path / f"{table.name}.csv").open(encoding="utf-8", newline="") as file:
        lines = csv.reader(file)
        assert next(lines) == [one.name for one in table.columns]
        rows = list(lines)
    return {one.name: [read[one.kind](row[place]) for row in rows] for place, one in enumerate(table.columns)}


def of_parquet(path: Path, table: ExportTable) -> Cells:
    read = pa.parquet.read_table(path / f"{table.name}.parquet")
    kinds = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string(), "flag": pa.bool_()}
    assert json.loads(read.schema.metadata[b"palp"])["sheet"]["lab"]
    for one, field in zip(table.columns, read.schema, strict=True):
        assert (field.name, field.type) == (one.name, kinds[one.kind])
        assert field.metadata == {b"unit": one.unit.encode(), b"meaning": one.meaning.encode()}
    return {name: [None if c != c else c for c in read[name].to_pylist()] for name in read.column_names}


def of_mat(path: Path, table: ExportTable) -> Cells:
    struct = loadmat(path, chars_as_strings=True)[table.name][0, 0]
    assert list(struct.dtype.names) == [one.name for one in table.columns]
    dtypes = {"integer": np.int64, "number": np.float64, "text": object, "flag": np.int8}
    found: Cells = {}
    for one in table.columns:
        values = struct[one.name]
        assert values.dtype == dtypes[one.kind]
        assert values.shape == (len(table), 1)
        cells = values[:, 0].tolist()
        if one.kind == "text":
            cells = ["".join(cell.tolist()) for cell in cells]
        found[one.name] = [_plain(one, cell) for cell in cells]
    return found


READERS: dict[Form, Callable[[Path, ExportTable], Cells]] = {
    "csv": of_csv,
    "parquet": of_parquet,
    "mat": of_mat,
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("which", ["source", "empty"])
def test_what_is_read_is_what_was_there_cell_by_cell(
    form: Form, which: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    written: ExportSource = request.getfixturevalue(which)
    write_export(written, form, out := tmp_path / "out")
    for table in written.tables.values():
        assert READERS[form](out, table) == expected(table)


def test_the_tables_say_what_the_record_says(source: ExportSource) -> None:
    trials, rows = expected(source.tables["trials"]), odd_rows(source.path)
    session = read_session(source.path)
    place = {trial: i for i, trial in enumerate(trials["trial"])}
    for one in session.trials:
        at = place[one.probes[0].trial]
        assert trials["right"][at] is one.right
        assert trials["confidence"][at] == one.confidence
        assert trials["palpations"][at] == len(one.probes)
        assert trials["verdict"][at] == one.verdict
    assert trials["right"][0] is trials["estimate_m"][0] is trials["confidence"][0] is None
    assert [i for i, one in enumerate(trials["excluded"]) if one] == [place[1001]]
    iterations = expected(source.tables["iterations"])
    assert iterations["posterior_2p5mm"] == [row.posterior[1] if row.posterior else None for row in rows]
    assert iterations["start_s"] == [row.start_ns / 1e9 for row in rows]
    assert iterations["enter_s"][:2] == [None, 0.123456789]
    sweeps = source.tables["sweeps"].values
    for row in rows:
        torque_n_m, rate_hz = read_sweep(source.path, row.row)
        mine = sweeps["row"] == row.row
        assert np.array_equal(sweeps["torque_n_m"][mine], torque_n_m)
        assert np.array_equal(sweeps["time_s"][mine], np.arange(torque_n_m.size) / rate_hz)
    muscles = source.tables["emg"].values
    assert muscles["time_s"][0] == 2.5
    assert set(muscles["phase"][100:175]) == {""}
    assert set(muscles["phase"][175:300]) == {"mvc"}


def test_an_estimate_on_a_grid_is_right_if_the_true_depth_is_the_nearest_that_was_taught(
    source: ExportSource,
) -> None:
    rows = [row for row in read_rows(source.path) if row.phase == "training"]  # of 2, 2.5 and 8 mm
    believed: dict[str, Any] = {"phase": "estimation", "posterior": [0.2] * 5, "gain": [0.0] * 5}
    cases = [(0.002, 0.0021, True), (0.002, 0.0024, False), (0.0025, 0.0024, True), (0.008, 0.005, False)]
    for number, (depth_m, estimate_m, _) in enumerate(cases):
        more = {"trial": 1000 + number, "depth_m": depth_m, "estimate_m": estimate_m}
        rows.append(msgspec.structs.replace(rows[0], **(believed | more)))
    trials = expected(trials_table(rows, (0.002, 0.0021, 0.0024, 0.005, 0.008), "none", {}))
    assert [one for one in trials["right"] if one is not None] == [right for *_, right in cases]


def test_every_field_of_a_row_is_a_column() -> None:
    names = {one.name.partition("_<")[0] for one in dictionary()["iterations"]}
    fields = {
        name.removesuffix("_ns") + ("_s" if name.endswith("_ns") else "") for name in Row.__struct_fields__
    }
    assert fields <= names
    assert names - fields == {"subject"}


def test_names_of_columns_are_names_everywhere() -> None:
    for table in dictionary():
        for one in columns_of(table, [0.0, 0.0025, -0.001, 1e-7]):
            assert one.name.isidentifier()
            assert one.name.isascii()
            assert len(one.name) < 32
            assert one.meaning
            assert bool(one.unit) is (one.kind in ("integer", "number"))


def test_the_page_of_the_dictionary_has_every_table_and_column() -> None:
    sections = dict(part.split("\n", 1) for part in dictionary_page().split("\n## ")[1:])
    assert list(sections) == list(dictionary())
    for table, columns in dictionary().items():
        rows = [line.split(" | ")[0].strip("| ") for line in sections[table].splitlines()[3:]]
        assert rows == [f"`{one.name}`" for one in columns]


def test_the_script_of_the_documentation_opens_the_mat_file(
    source: ExportSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "docs" / "how_to" / "sessions.md").read_text(encoding="utf-8")
    script = next(part.partition("```")[0] for part in text.split("```python\n")[1:] if "loadmat" in part)
    assert len(script.strip().splitlines()) <= 5
    write_export(source, "mat", tmp_path / "S01.mat")
    monkeypatch.chdir(tmp_path)
    exec(script, {})
    right = [one for one in expected(source.tables["trials"])["right"] if one is not None]
    assert f"{np.mean(right)}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("form", "name"), [("csv", "S01_csv"), ("parquet", "S01_parquet"), ("mat", "S01.mat")]
)
def test_nothing_is_overwritten_unasked_and_what_cannot_be_written_leaves_what_was_there(
    form: Form, name: str, source: ExportSource, tmp_path: Path
) -> None:
    out = default_out(tmp_path / "deep" / "S01", form)
    assert out == tmp_path / "deep" / name
    write_export(source, form, out)
    assert [path.name for path in out.parent.iterdir()] == [name]
    with pytest.raises(PalpError, match="there already"):
        write_export(source, form, out)
    write_export(source, form, out, overwrite=True)
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("x", encoding="utf-8")
    with pytest.raises(PalpError, match="not an export"):
        write_export(source, form, mine, overwrite=True)
    kept = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert mine / "thesis.txt" in kept
    table = source.tables["emg"]
    wrong: Any = np.zeros(3) if form == "csv" else None
    broken = dataclasses.replace(table, values={**table.values, "edc_v": wrong})
    damaged = dataclasses.replace(source, tables={**source.tables, "emg": broken})
    with pytest.raises((TypeError, AttributeError, ValueError)):
        write_export(damaged, form, out, overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == kept


def test_a_bag_has_what_the_folder_has_and_emg(rig_session: RigSession, tmp_path: Path) -> None:
    folder, bag = read_source(rig_session.out), read_source(rig_session.bag)
    for name in ("trials", "iterations", "sweeps"):
        assert expected(folder.tables[name]) == expected(bag.tables[name])
    assert len(folder.tables["emg"]) == 0
    assert any("palp session export BAG" in words for words in folder.notes)
    muscles = bag.tables["emg"].values
    assert len(bag.tables["emg"]) > 1000
    assert set(muscles["phase"]) >= {"rest", "mvc", "palpation"}
    result = CliRunner().invoke(
        app, ["session", "export", str(rig_session.bag), "--to", "csv", "--out", str(tmp_path / "x")]
    )
    assert result.exit_code == 0, result.output
    assert f"{len(bag.tables['emg'])} emg" in result.stdout


def test_what_is_no_session_is_refused_in_words(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["session", "export", str(tmp_path), "--to", "csv"])
    assert isinstance(result.exception, PalpError)
    assert "not a session's folder" in str(result.exception)
