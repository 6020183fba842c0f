"""Tables as Parquet files, each column with its unit and meaning, each file with the session's sheet."""

from __future__ import annotations

import json
from pathlib import Path

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.export.dictionary import FLAG_MISSING
from palp_core.palpation.export.source import ExportSource


def write(source: ExportSource, folder: Path) -> None:
    """Write a Parquet file per table into a folder."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise PalpError(f"Parquet needs pyarrow; install it with: {install_line('parquet')}") from error
    kinds = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string(), "flag": pa.bool_()}
    for table in source.tables.values():
        fields, arrays = [], []
        for one in table.columns:
            values = table.values[one.name]
            missing = values == FLAG_MISSING if one.kind == "flag" else None
            shown = values.astype(bool) if one.kind == "flag" else values
            arrays.append(pa.array(shown, type=kinds[one.kind], mask=missing, from_pandas=False))
            fields.append(
                pa.field(one.name, kinds[one.kind], metadata={"unit": one.unit, "meaning": one.meaning})
            )
        schema = pa.schema(fields, metadata={"palp": json.dumps(source.facts, ensure_ascii=False)})
        written = pa.Table.from_arrays(arrays, schema=schema)
        parquet.write_table(written, folder / f"{table.name}.parquet", compression="zstd")
