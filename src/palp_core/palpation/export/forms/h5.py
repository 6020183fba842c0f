"""One HDF5 file: a group per table, a dataset per column with its unit and meaning as attributes."""

from __future__ import annotations

import json
from pathlib import Path

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.export.source import ExportSource


def write(source: ExportSource, path: Path) -> None:
    """Write the file.

    Raises:
        PalpError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise PalpError(f"HDF5 needs h5py; install it with: {install_line('emg')}") from error
    with h5py.File(path, "w") as file:
        file.attrs["palp"] = json.dumps(source.facts, ensure_ascii=False)
        for table in source.tables.values():
            group = file.create_group(table.name)
            group.attrs["columns"] = [one.name for one in table.columns]
            for one in table.columns:
                values = table.values[one.name]
                dtype = h5py.string_dtype() if one.kind == "text" else values.dtype
                packing = {"compression": "gzip", "compression_opts": 4} if len(values) else {}
                dataset = group.create_dataset(one.name, data=values, dtype=dtype, **packing)
                dataset.attrs["unit"], dataset.attrs["meaning"] = one.unit, one.meaning
