"""A column of ``trials.csv`` is a field of ``Row``; a row is there whole, with its sweep, or not at all.

A damaged row is reported with its line, never skipped; no session is overwritten unasked.
"""

from __future__ import annotations

import errno
import os
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.session_folder import (
    OWN_FILES,
    REPLACED,
    RUN,
    TABLE,
    forget_replaced,
    refuse_input,
    refuse_occupied,
    restore_replaced,
    take_over,
)
from palp_core.palpation.session.trials_csv import Row, SessionWriter, read_rows, read_sweep

FACTS: dict[str, Any] = {
    "row": 0, "session": "s, \"quoted\"", "phase": "estimation", "phantom": "A", "remount": 2, "trial": 3,
    "depth_m": 0.002, "iteration": 4, "ring_m": 0.016, "true_ring_m": 0.0161, "true_height_m": -1e-5,
    "peak_n_m": 0.01, "posterior": [0.25, 0.75], "gain": [0.5, 0.125], "gamma": 0.5, "verdict": "decided",
    "estimate_m": 0.002, "outlier": True, "policy": "fixed", "seed": 7, "start_ns": 1, "end_ns": 2**60,
    "landed": False, "guards": ["lift-off; at last", "stuck, too"],
    "enter_ns": 3, "leave_ns": 2**61,
}  # fmt: skip
NOTHING: dict[str, Any] = {
    "row": 1, "posterior": [], "gain": [], "gamma": None, "estimate_m": None, "true_ring_m": None,
    "true_height_m": None, "outlier": False, "landed": False, "guards": [],
    "enter_ns": None, "leave_ns": None,
}  # fmt: skip


def row(number: int) -> Row:
    return Row(**(FACTS | {"row": number}))


def written(folder: Path, count: int = 2) -> SessionWriter:
    """Write a session of palpations whose torque is their number."""
    writer = SessionWriter(str(folder), (0.002, 0.004))
    writer.start()
    for number in range(count):
        writer.append(row(number), np.full(3, float(number)), 1000.0)
    return writer


@pytest.fixture
def writer(tmp_path: Path) -> SessionWriter:
    return written(tmp_path / "out")


def test_every_column_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    assert set(FACTS) == set(Row.__struct_fields__)
    writer = written(tmp_path, 1)
    torque_n_m = np.random.default_rng(1).standard_normal(4001)
    writer.append(Row(**(FACTS | NOTHING)), torque_n_m, 1000.0)
    assert read_rows(tmp_path) == [row(0), Row(**(FACTS | NOTHING))]
    read, rate_hz = read_sweep(tmp_path, 1)
    assert (read.tolist(), rate_hz) == (torque_n_m.tolist(), 1000.0)
    with np.load(tmp_path / "sweeps" / "000001.npz") as content:
        assert sorted(content) == ["rate_hz", "torque_n_m"]


def test_palpations_of_the_trial_under_way_are_set_aside_each_time_a_session_resumes(tmp_path: Path) -> None:
    written(tmp_path, 6).close()
    for count in (5, 2):
        resumed = SessionWriter(str(tmp_path), (0.002, 0.004))
        resumed.go_on(count)
        resumed.close()
    assert read_rows(tmp_path) == [row(0), row(1)]
    assert read_rows(tmp_path / "interrupted" / "1") == [row(5)]
    assert read_rows(tmp_path / "interrupted" / "2") == [row(2), row(3), row(4)]
    assert [path.name for path in sorted((tmp_path / "sweeps").iterdir())] == ["000000.npz", "000001.npz"]
    assert read_sweep(tmp_path / "interrupted" / "2", 3)[0].tolist() == [3.0, 3.0, 3.0]


def full_after(count: int) -> Callable[[int, Any], int]:
    """Return a ``write`` of a disk that has room for so many bytes more."""
    left, write = [count], os.write

    def limited(descriptor: int, data: Any) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = write(descriptor, bytes(data)[: left[0]])
        left[0] -= taken
        return taken

    return limited


@pytest.mark.parametrize("room", [0, 1, 40])
def test_a_row_that_a_full_disk_cuts_is_not_there_and_the_next_is_on_its_own_line(
    writer: SessionWriter, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full_after(room))
        with pytest.raises(PalpError, match="No space left on device") as refused:
            writer.append(row(2), np.zeros(3), 1000.0)
    assert str(writer.folder.absolute()) in str(refused.value)
    assert "the 2 palpations before are kept there" in str(refused.value)
    assert read_rows(writer.folder) == [row(0), row(1)]
    assert len(list((writer.folder / "sweeps").iterdir())) == 2
    writer.append(row(2), np.zeros(3), 1000.0)  # there is room again
    assert read_rows(writer.folder) == [row(0), row(1), row(2)]


@pytest.mark.parametrize(
    ("done", "words"),
    [
        (lambda it: it.rename(it.with_name("else")), "was removed or renamed while the session ran.*2 palp"),
        (shutil.rmtree, "was removed or renamed while the session ran"),
        (lambda it: (it / TABLE).unlink(), "trials.csv was removed while the session ran.*next to it"),
    ],
)
def test_a_folder_that_is_taken_away_ends_the_session_in_words(
    writer: SessionWriter, done: Callable[[Path], None], words: str
) -> None:
    done(writer.folder)
    with pytest.raises(PalpError, match=words):
        writer.append(row(2), np.zeros(3), 1000.0)
    shutil.rmtree(writer.folder, ignore_errors=True)
    with pytest.raises(PalpError, match=r"what training taught cannot be written.*was removed or renamed"):
        writer.primitives({})


def test_a_last_row_that_was_cut_short_is_left_out_with_a_warning(
    writer: SessionWriter, caplog: pytest.LogCaptureFixture
) -> None:
    table = writer.folder / TABLE
    with table.open("a") as file:
        file.write("2,s,estim")
    assert read_rows(writer.folder) == [row(0), row(1)]
    assert f"{table}: the last row was cut short and is left out: '2,s,estim" in caplog.text


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda head, one, two: [head, one[:30] + "\n", two], r":2: the row is damaged \(\d+ cells under 28"),
        (
            lambda head, one, two: [head, one[:-1] + one, two],
            r":2: the row is damaged \(55 cells under 28 col",
        ),
        (lambda head, one, two: [head, "x" + one, two], ":2: the row is damaged"),
        (lambda head, one, two: [head, one, two, one], r":4: row 0 follows row 1: a part .* is there twice"),
    ],
)
def test_a_damaged_row_is_named_by_its_line(
    writer: SessionWriter, damage: Callable[..., list[str]], words: str
) -> None:
    table = writer.folder / TABLE
    table.write_text("".join(damage(*table.read_text().splitlines(keepends=True))))
    with pytest.raises(PalpError, match=f"trials.csv{words}"):
        read_rows(writer.folder)


def inflating(path: Path) -> None:
    """Write a few kB that unpack to 160 MiB."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as file:
        for _ in range(160):
            file.write(bytes(1 << 20))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:100]), "the sweep of row 1 cannot be read"),
        (Path.unlink, "the sweep of row 1 cannot be read"),
        (inflating, "row 1 cannot be read: .*it unpacks to more than 128 MiB"),
    ],
)
def test_a_sweep_that_is_missing_damaged_or_too_large_is_named(
    writer: SessionWriter, damage: Callable[[Path], object], words: str
) -> None:
    damage(writer.folder / "sweeps" / "000001.npz")
    with pytest.raises(PalpError, match=rf"000001.npz: .*{words}"):
        read_sweep(writer.folder, 1)


# the folder


def test_a_second_session_is_refused_until_the_first_has_closed(tmp_path: Path) -> None:
    first, second = SessionWriter(str(tmp_path), [0.002]), SessionWriter(str(tmp_path), [0.002])
    first.start()
    with pytest.raises(PalpError, match="another session is writing"):
        second.start()
    first.close()
    (tmp_path / RUN).write_text("{}")  # it ended before its first palpation, and is in no one's way
    second.start()
    second.close()


def test_a_session_is_replaced_only_by_one_that_asks_for_it(tmp_path: Path) -> None:
    written(tmp_path, 1).close()
    (tmp_path / "notes.txt").write_text("mine")
    second = SessionWriter(str(tmp_path), (0.002, 0.004))
    with pytest.raises(
        PalpError, match=r"holds a session already \(trials.csv, sweeps\).*out:=NAME.*overwrite:=true"
    ):
        second.start()
    assert len(read_rows(tmp_path)) == 1
    second.start(overwrite=True)
    second.close()
    assert read_rows(tmp_path) == []
    assert not list((tmp_path / "sweeps").iterdir())
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", [name for name in OWN_FILES if name not in (TABLE, "sweeps", RUN)])
def test_any_file_that_a_session_would_replace_is_in_its_way(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("of a study, say")
    with pytest.raises(PalpError, match=name):
        SessionWriter(str(tmp_path), (0.002,)).start()
    assert (tmp_path / name).read_text() == "of a study, say"


def test_latest_leads_to_the_last_folder_that_is_named_by_its_time(tmp_path: Path) -> None:
    for name in ("2026-11-22_21-05-09", "2026-11-22_21-05-10", "mine"):
        written(tmp_path / name, 1)
    assert (tmp_path / "latest").readlink() == Path("2026-11-22_21-05-10")
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").mkdir()  # the user's own
    written(tmp_path / "2026-11-22_21-05-11", 1)
    assert not (tmp_path / "latest").is_symlink()
    assert not list(tmp_path.glob(".latest*"))


def test_a_session_that_is_to_be_replaced_stays_until_the_other_has_a_row(tmp_path: Path) -> None:
    for name in (TABLE, RUN, "result.json"):
        (tmp_path / name).write_text("a\n1\n")
    (tmp_path / "mine.txt").write_text("mine")
    take_over(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [REPLACED, "mine.txt"]
    with pytest.raises(PalpError, match="holds a session already"):
        refuse_occupied(tmp_path)
    (tmp_path / TABLE).write_text("b\n")
    take_over(tmp_path)  # another one that ended before its first palpation
    restore_replaced(tmp_path)
    assert (tmp_path / TABLE).read_text() == "a\n1\n"
    assert not (tmp_path / REPLACED).exists()
    take_over(tmp_path)
    (tmp_path / TABLE).write_text("b\n2\n")
    forget_replaced(tmp_path)
    restore_replaced(tmp_path)
    assert (tmp_path / TABLE).read_text() == "b\n2\n"


def test_what_is_no_session_is_not_replaced_and_an_input_is_not_removed(tmp_path: Path) -> None:
    (tmp_path / "charts").mkdir()
    (tmp_path / "charts/thesis.png").write_text("x")
    (tmp_path / "noise.yaml").write_text("mine")
    with pytest.raises(PalpError, match="but neither"):
        take_over(tmp_path)
    assert (tmp_path / "charts/thesis.png").exists()
    for name in ("noise.yaml", "sweeps/bag/bag_0.mcap"):
        with pytest.raises(PalpError, match=r"noise:=x is in .* move it elsewhere"):
            refuse_input(tmp_path, tmp_path / name, "noise:=x")
    refuse_input(tmp_path, tmp_path / "mine.yaml", "noise:=x")
