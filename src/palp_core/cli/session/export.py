"""``palp session export``: a session for other tools."""

from pathlib import Path
from typing import Annotated, Literal

from palp_core.cli.options import argument, option
from palp_core.cli.output import note, print_text


def export(
    path: Annotated[Path, argument("A session's folder, or a bag of its run.", "DIR|BAG")],
    to: Annotated[Literal["csv", "parquet", "mat"], option("The format.", "--to")],
    *,
    out: Annotated[
        Path | None, option("Folder; of mat the file. Default: beside DIR or BAG.", "--out", "-o")
    ] = None,
    overwrite: Annotated[bool, option("An earlier export is replaced.", "--overwrite")] = False,
) -> None:
    from palp_core.palpation.export.export import default_out, write_export
    from palp_core.palpation.export.source import read_source

    source = read_source(path)
    target = out or default_out(path, to)
    write_export(source, to, target, overwrite=overwrite)
    counts = ", ".join(f"{len(table)} {name}" for name, table in source.tables.items())
    for words in source.notes:
        note(words)
    print_text(f"{target}: {counts}")
