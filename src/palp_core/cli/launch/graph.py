"""``palp graph``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.output import print_text


def graph(
    file: Annotated[Path, typer.Argument(help="Launch file.")],
    arguments: Annotated[
        list[str] | None, typer.Argument(metavar="[name:=value]...", help="Its arguments.")
    ] = None,
    *,
    png: Annotated[Path | None, typer.Option("--png", "-o", help="Draw to this PNG file.")] = None,
) -> None:
    """Print a launch file's graph as mermaid text; --png draws it."""
    from palp_core.graph.description.diagram import draw_png, mermaid
    from palp_core.graph.launch.graph import check_file

    checked = check_file(file, arguments or [])
    print_text(mermaid(checked).rstrip())
    if png is not None:
        draw_png(checked, png)
