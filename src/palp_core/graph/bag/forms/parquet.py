"""A bag as Parquet files."""

import contextlib
from pathlib import Path
from typing import Any

from palp_core.errors import BagError
from palp_core.extras import install_line
from palp_core.graph.bag.forms.tables import new_folder, rows, table_name
from palp_core.graph.bag.reader import Bag

PARQUET_ROWS = 8192


def write(bag: str | Path, out: str | Path) -> int:
    """Write one Parquet file per topic into a folder; needs ``pyarrow``.

    Returns:
        How many messages there are.

    Raises:
        BagError: pyarrow is not installed, no such bag, or the folder exists.
        BagDamaged: The bag is damaged.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise BagError(f"Parquet needs pyarrow; type: {install_line('parquet')}") from error
    folder = new_folder(out)
    tables: dict[str, Any] = {}
    waiting: dict[str, list[dict[str, Any]]] = {}

    def flush(topic: str) -> None:
        table = pa.Table.from_pylist(waiting.pop(topic), tables[topic].schema if topic in tables else None)
        if topic not in tables:
            path = folder / f"{table_name(topic)}.parquet"
            tables[topic] = stack.enter_context(pq.ParquetWriter(path, table.schema))
        tables[topic].write_table(table)

    count = 0
    with Bag(bag) as opened, contextlib.ExitStack() as stack:
        for topic, row in rows(opened):
            waiting.setdefault(topic, []).append(row)
            count += 1
            if len(waiting[topic]) >= PARQUET_ROWS:
                flush(topic)
        for topic in list(waiting):
            flush(topic)
    return count
