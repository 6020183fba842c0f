"""``palp session export``: a session in the format that another tool reads, whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.export.tables import FLAG_MISSING, ExportTable
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.many.overview import DICTIONARY_FILE
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.sheet import sheet_text

Form = Literal["csv", "parquet", "mat"]
FORMS: tuple[Form, ...] = get_args(Form)

_FILES: dict[Form, str] = {"mat": ".mat"}  # the others are folders
_MOST_BYTES = (1 << 31) - (1 << 20)  # of a variable, in version 5 of MATLAB's format


def default_out(path: Path, form: Form) -> Path:
    """Return where an export goes by default: next to what is exported."""
    name = path.resolve().name.removesuffix(".mcap")
    return path.resolve().with_name(f"{name}{_FILES[form]}" if form in _FILES else f"{name}_{form}")


def write_export(source: ExportSource, form: Form, out: Path, *, overwrite: bool = False) -> None:
    """Write a session to a folder, or the file of forms that have one; only an earlier export is replaced."""
    _refuse_existing(out, form, overwrite=overwrite)
    out.parent.mkdir(parents=True, exist_ok=True)
    with _whole(out, form, overwrite=overwrite) as part:
        if form in _FILES:
            _FORMS[form](source, part)
            return
        part.mkdir()
        _FORMS[form](source, part)
        lines = [
            (table.name, one.name, one.kind, one.unit, one.meaning)
            for table in source.tables.values()
            for one in table.columns
        ]
        write_csv(part / DICTIONARY_FILE, ("table", "column", "kind", "unit", "meaning"), lines)
        if source.sheet is not None:
            (part / SHEET).write_text(sheet_text(source.sheet), encoding="utf-8")


def _refuse_existing(out: Path, form: Form, *, overwrite: bool) -> None:
    if not os.path.lexists(out):
        return
    if not overwrite:
        raise PalpError(
            f"{out} is there already, and nothing is overwritten unasked: --overwrite, or --out NAME"
        )
    earlier = out.is_file() if form in _FILES else (out / DICTIONARY_FILE).exists()
    if not earlier:
        raise PalpError(f"{out} is not an export; choose another with --out NAME")


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


def _write_csv(source: ExportSource, folder: Path) -> None:
    """Write a CSV per table: UTF-8, numbers with all their digits, an empty cell where there is no value."""
    import pandas as pd

    words = np.array(["false", "true", ""], dtype=object)  # FLAG_MISSING is the last
    for table in source.tables.values():
        columns = {
            one.name: words[table.values[one.name]] if one.kind == "flag" else table.values[one.name]
            for one in table.columns
        }
        pd.DataFrame(columns).to_csv(folder / f"{table.name}.csv", index=False, lineterminator="\n")


def _write_parquet(source: ExportSource, folder: Path) -> None:
    """Write a Parquet file per table, each column with unit and meaning, each file with the sheet."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise PalpError(f"Parquet needs pyarrow; install it with: {install_line('parquet')}") from error
    kinds = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string(), "flag": pa.bool_()}
    for table in source.tables.values():
        fields, arrays = [], []
        for one in table.columns:
            values, kind, missing = table.values[one.name], kinds[one.kind], None
            if one.kind == "flag":
                values, missing = values.astype(bool), values == FLAG_MISSING
            arrays.append(pa.array(values, type=kind, mask=missing, from_pandas=False))
            fields.append(pa.field(one.name, kind, metadata={"unit": one.unit, "meaning": one.meaning}))
        schema = pa.schema(fields, metadata={"palp": json.dumps(source.facts, ensure_ascii=False)})
        written = pa.Table.from_arrays(arrays, schema=schema)
        parquet.write_table(written, folder / f"{table.name}.parquet", compression="zstd")


def _write_mat(source: ExportSource, path: Path) -> None:
    """Write a MATLAB file of version 5: a struct per table, a column vector per column, texts as cells."""
    from scipy.io import savemat

    content: dict[str, Any] = {name: _struct(table) for name, table in source.tables.items()}
    for name, struct in content.items():
        if sum(column.nbytes for column in struct.values()) > _MOST_BYTES:
            raise PalpError(f"table '{name}' is larger than the 2 GB that a .mat file takes: --to parquet")
    content["facts_json"] = json.dumps(source.facts, ensure_ascii=False)
    content["dictionary"] = {
        table.name: {one.name: f"{one.meaning} [{one.unit or one.kind}]" for one in table.columns}
        for table in source.tables.values()
    }
    savemat(path, content, appendmat=False, do_compression=True, oned_as="column", long_field_names=True)


def _struct(table: ExportTable) -> dict[str, Any]:
    return {one.name: np.reshape(table.values[one.name], (-1, 1)) for one in table.columns}


_FORMS: dict[Form, Callable[[ExportSource, Path], None]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mat": _write_mat,
}
