"""Tables as CSV: UTF-8, a heading, numbers with all their digits, an empty cell where there is no value."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.export.dictionary import FLAG_MISSING
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.export.tables import ExportTable


def write(source: ExportSource, folder: Path) -> None:
    """Write ``trials.csv``, ``iterations.csv``, ``sweeps.csv`` and ``emg.csv`` into a folder."""
    for table in source.tables.values():
        frame_of(table).to_csv(folder / f"{table.name}.csv", index=False, lineterminator="\n")


def frame_of(table: ExportTable) -> Any:
    """Return a table as pandas has it, its flags as words."""
    import pandas as pd

    words = np.array(["false", "true", ""], dtype=object)  # FLAG_MISSING is the last
    assert words[FLAG_MISSING] == ""
    return pd.DataFrame(
        {
            one.name: words[table.values[one.name]] if one.kind == "flag" else table.values[one.name]
            for one in table.columns
        }
    )
