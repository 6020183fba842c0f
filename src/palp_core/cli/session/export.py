"""``palp session export``: a session for other tools."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from palp_core.cli.output import note, print_text


def export(
    path: Annotated[Path, typer.Argument(metavar="DIR|BAG", help="A session's folder, or a bag of its run.")],
    to: Annotated[Literal["csv", "parquet", "mat"], typer.Option("--to", help="The format.")],
    *,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder; of mat the file. Default: beside DIR or BAG."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="An earlier export is replaced.")] = False,
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
