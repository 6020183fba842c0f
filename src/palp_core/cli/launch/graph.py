"""``palp graph``."""

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
    as_dot: Annotated[
        bool, typer.Option("--dot", help="For Graphviz: palp graph FILE --dot | dot -Tpng")
    ] = False,
) -> None:
    """Print a launch file's graph as Mermaid text, or as DOT for Graphviz."""
    from palp_core.graph.description.diagram import dot, mermaid
    from palp_core.graph.launch.graph import check_file

    draw = dot if as_dot else mermaid
    print_text(draw(check_file(file, arguments or [])).rstrip())
