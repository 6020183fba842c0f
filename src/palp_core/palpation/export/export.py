"""``palp session export``: a session in the format that another tool reads, whole or not at all."""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args

from palp_core.errors import PalpError
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.many.overview import DICTIONARY_FILE
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.sheet_file import sheet_text

Form = Literal["csv", "parquet", "mat"]
FORMS: tuple[Form, ...] = get_args(Form)

_FILES: dict[Form, str] = {"mat": ".mat"}  # the others are folders


def default_out(path: Path, form: Form) -> Path:
    """Return where an export goes if nobody says it: beside what is exported."""
    name = path.resolve().name.removesuffix(".mcap")
    return path.resolve().with_name(f"{name}{_FILES[form]}" if form in _FILES else f"{name}_{form}")


def write_export(source: ExportSource, form: Form, out: Path, *, overwrite: bool = False) -> None:
    """Write a session."""
    _refuse_existing(out, form, overwrite=overwrite)
    write = importlib.import_module(f"palp_core.palpation.export.forms.{form}").write
    out.parent.mkdir(parents=True, exist_ok=True)
    with _whole(out, form, overwrite=overwrite) as part:
        if form not in _FILES:
            part.mkdir()
        write(source, part)
        if form not in _FILES:
            _write_beside(source, part)


def _refuse_existing(out: Path, form: Form, *, overwrite: bool) -> None:
    if not os.path.lexists(out):
        return
    if not overwrite:
        raise PalpError(
            f"{out} is there already, and nothing is overwritten unasked: --overwrite, or --out NAME"
        )
    earlier = out.is_file() if form in _FILES else (out / DICTIONARY_FILE).exists()
    if not earlier:
        raise PalpError(f"{out} is no earlier export, and is not replaced; name another, --out NAME")


def _write_beside(source: ExportSource, folder: Path) -> None:
    """Write what a folder of tables is to be understood by: dictionary and sheet."""
    lines = [
        (table.name, one.name, one.kind, one.unit, one.meaning)
        for table in source.tables.values()
        for one in table.columns
    ]
    write_csv(folder / DICTIONARY_FILE, ("table", "column", "kind", "unit", "meaning"), lines)
    if source.sheet is not None:
        (folder / SHEET).write_text(sheet_text(source.sheet), encoding="utf-8")


@contextlib.contextmanager
def _whole(out: Path, form: Form, *, overwrite: bool) -> Iterator[Path]:
    """Give a path for a folder or a file, which takes its name at the end, in place of an earlier one."""
    part = out.with_name(f".{out.name}.{os.getpid()}.part")
    _remove(part)
    try:
        yield part
        _refuse_existing(out, form, overwrite=overwrite)  # another may have been first
        if overwrite and out.is_dir():
            shutil.rmtree(out)
        part.replace(out)
    finally:
        _remove(part)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
