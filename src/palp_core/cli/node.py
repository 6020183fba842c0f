"""``palp node``: the nodes of the running graph."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from palp_core.cli.launch import print_text

__all__ = ["app"]

app = typer.Typer(help="Nodes of the running graph.", no_args_is_help=True)


@app.command("list")
def list_nodes(
    *,
    graph: Annotated[str | None, typer.Option(help="Name of the graph; default: the latest.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="For machines.")] = False,
) -> None:
    """List the nodes with class and process."""
    from palp_core.launch.run_directory import find_running

    record = find_running(graph)
    if as_json:
        print_text(json.dumps([{"name": f"/{n.name}", "run": n.run, "pid": n.pid} for n in record.nodes]))
        return
    for node in record.nodes:
        print_text(f"/{node.name}  {node.run}" + (f"  (process {node.pid})" if node.pid else ""))
