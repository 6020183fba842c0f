"""A row is there whole, with its sweep, or not at all; a damaged one is said with its line, never skipped."""

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
from palp_core.palpation.session.trials_csv import Row, SessionWriter, read_rows, read_sweep
from tests.palpation.session.test_trials_csv import FACTS


def row(number: int) -> Row:
    return Row(**(FACTS | {"row": number}))


@pytest.fixture
def writer(tmp_path: Path) -> SessionWriter:
    """A session of two palpations."""
    found = SessionWriter(str(tmp_path / "out"), (0.002, 0.004))
    found.start()
    for number in range(2):
        found.append(row(number), np.zeros(3), 1000.0)
    return found


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
        with pytest.raises(PalpError, match="No space left on device") as told:
            writer.append(row(2), np.zeros(3), 1000.0)
    assert str(writer.folder.absolute()) in str(told.value)
    assert "the 2 palpations before are kept there" in str(told.value)
    assert read_rows(writer.folder) == [row(0), row(1)]
    assert len(list((writer.folder / "sweeps").iterdir())) == 2
    writer.append(row(2), np.zeros(3), 1000.0)  # there is room again
    assert read_rows(writer.folder) == [row(0), row(1), row(2)]


def renamed(folder: Path) -> None:
    folder.rename(folder.with_name("elsewhere"))


def table_removed(folder: Path) -> None:
    (folder / "trials.csv").unlink()


@pytest.mark.parametrize(
    ("done", "words"),
    [
        (renamed, "was removed or renamed while the session ran.*2 palpations"),
        (shutil.rmtree, "was removed or renamed while the session ran"),
        (table_removed, "trials.csv was removed while the session ran.*next to it"),
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


def test_a_last_row_that_was_cut_short_is_left_out_and_said(
    writer: SessionWriter, caplog: pytest.LogCaptureFixture
) -> None:
    table = writer.folder / "trials.csv"
    with table.open("a") as file:
        file.write("2,s,estim")
    assert read_rows(writer.folder) == [row(0), row(1)]
    assert f"{table}: the last row was cut short and is left out: '2,s,estim" in caplog.text


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda line: line[:30], r"trials.csv:2: the row is damaged \(\d+ cells under 28 columns\)"),
        (lambda line: line[:-1] + line, r"trials.csv:2: the row is damaged \(55 cells under 28 columns\)"),
        (
            lambda line: "x" + line,
            "trials.csv:2: the row is damaged",
        ),
    ],
)
def test_a_damaged_row_is_named_by_its_line(
    writer: SessionWriter, damage: Callable[[str], str], words: str
) -> None:
    table = writer.folder / "trials.csv"
    lines = table.read_text().splitlines(keepends=True)
    lines[1] = damage(lines[1]).removesuffix("\n") + "\n"
    table.write_text("".join(lines))
    with pytest.raises(PalpError, match=words):
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
