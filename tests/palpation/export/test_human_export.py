"""``palp session export`` of a session with a person: others read what is written."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.export.export import FORMS, Form, write_export
from palp_core.palpation.export.source import ExportSource, read_source
from palp_core.palpation.export.tables import dictionary
from palp_core.palpation.session.audit import decide
from palp_core.palpation.session.human.record import HumanRow, HumanWriter
from palp_core.palpation.session.session_folder import RUN, SHEET
from palp_core.palpation.session.sheet.sheet import SessionSheet, sheet_text
from palp_core.whole_file import write_json
from tests.palpation.export.test_export import READERS, expected
from tests.support.sessions import describe

OF_PERSON = SessionSheet(
    lab="Motor Lab", operator="AB", subject="S-01", ethics="17-204", began="2026-11-22_21-05-09"
)

ROW = HumanRow(
    row=0, subject="S-01", phase="training", trial=1, attempt=1, phantom="A", depth_m=0.002,
    told=True, palpation_s=2.5, ended_by="subject", answer_s=None, answer_mm=None, estimate_m=None, emg="",
    lost_count=0, clipped_count=0, source="person", answered_by="AB", order="paper", subject_number=1, seed=1,
    end_ns=1_500_000_001,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rest, MVC, a trial that was spoilt and done again, one of estimation, one sealed and without EMG."""
    out, rng = tmp_path_factory.mktemp("person") / "S01", np.random.default_rng(1)
    writer = HumanWriter(str(out))
    writer.start()

    def emg(name: str, count: int, *, discarded: bool = False) -> str:
        samples_v = 1e-4 * rng.normal(size=(2, count))
        samples_v[:, 7:9] = np.nan
        return writer.emg("S-01", name, samples_v, 1500.0, discarded=discarded)

    emg("rest.npz", 300)
    emg("mvc_1.npz", 300, discarded=True)
    emg("mvc.npz", 750)
    replace = msgspec.structs.replace
    asked = {"phase": "estimation", "told": False, "answer_s": 1.25, "answer_mm": 4.0, "estimate_m": 0.004}
    rows = [
        replace(ROW, ended_by="repeat", emg=emg("training/01_2mm.npz", 450, discarded=True)),
        replace(ROW, row=1, attempt=2, emg=emg("training/01b_2mm.npz", 450)),
        replace(ROW, row=2, trial=1, emg=emg("estimation/01_2mm.npz", 600), **asked),
        replace(ROW, row=3, trial=2, depth_m=None, **asked),
    ]
    for row in rows:
        writer.append(row)
    attached = {SHEET: sheet_text(OF_PERSON)}
    write_json(out / RUN, msgspec.structs.replace(describe(out), attached=attached, exit_code=0))
    decide(out, ("estimation", 1), "exclude", "the subject looked")
    return out


@pytest.fixture(scope="module")
def source(folder: Path) -> ExportSource:
    return read_source(folder)


@pytest.mark.parametrize("form", FORMS)
def test_what_is_read_is_what_was_there_cell_by_cell(
    form: Form, source: ExportSource, tmp_path: Path
) -> None:
    write_export(source, form, out := tmp_path / "out")
    assert [*source.tables] == [name for name in dictionary() if name.startswith("human_")]
    for table in source.tables.values():
        assert READERS[form](out, table) == expected(table)


def test_the_tables_say_what_the_record_says(folder: Path, source: ExportSource) -> None:
    trials, recordings = expected(source.tables["human_trials"]), expected(source.tables["human_recordings"])
    assert trials["answer_m"] == [None, None, 0.004, 0.004]
    assert trials["depth_m"] == [0.002, 0.002, 0.002, None]
    assert trials["recording"] == [2, 3, 4, -1]
    assert trials["excluded_why"] == ["spoilt, and done again", "", "exclude: the subject looked", ""]
    assert trials["excluded"] == [True, False, True, False]
    assert "right" not in trials  # whose answers these are decides whether they are ever scored
    assert recordings["phase"] == ["rest", "mvc", "training", "training", "estimation"]
    assert recordings["trial"] == [-1, -1, 1, 1, 1]
    emg = source.tables["human_emg"].values
    for number, file in enumerate(recordings["file"]):
        with np.load(folder / file) as kept:
            mine = emg["recording"] == number
            np.testing.assert_array_equal(emg["edc_v"][mine], kept["edc_v"])
            np.testing.assert_array_equal(emg["time_s"][mine], np.arange(mine.sum()) / 1500.0)


def test_every_field_of_a_row_is_a_column() -> None:
    names = {one.name for one in dictionary()["human_trials"]}
    renamed = {"answer_mm": "answer_m", "end_ns": "end_s", "emg": "recording", "row": "trial"}
    assert {renamed.get(name, name) for name in HumanRow.__struct_fields__} <= names


def test_emg_that_is_gone_is_named(folder: Path, tmp_path: Path) -> None:
    import shutil

    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copy / "emg/S-01/estimation/01_2mm.npz").unlink()
    with pytest.raises(PalpError, match=r"01_2mm\.npz: this EMG cannot be read"):
        read_source(copy)
