"""One MATLAB file: a struct per table with a column vector per column, texts as cells."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.export.tables import ExportTable

_MOST_BYTES = (1 << 31) - (1 << 20)  # of a variable, in version 5 of the format


def write(source: ExportSource, path: Path) -> None:
    """Write the file, of version 5, which all of MATLAB, Octave and SciPy read."""
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
