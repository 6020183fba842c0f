"""``palp interface``: types of messages and services, of the running graph or of a workspace."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from palp_core.cli import completion
from palp_core.cli.options import GraphOption, JsonOption
from palp_core.cli.output import print_json, print_text
from palp_core.errors import GraphError

app = typer.Typer()

WorkspaceOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="A folder with msgs/; default: the running graph's, else here."),
]


@app.command("list")
def list_interfaces(
    *, workspace: WorkspaceOption = None, graph: GraphOption = None, as_json: JsonOption = False
) -> None:
    """List the types of the running graph or of a workspace."""
    from palp_core.cli.node.interface_source import known_types

    types = known_types(graph, workspace)
    if as_json:
        print_json([{"name": t.name, "module": t.module, "hash": t.type_hash} for t in types])
        return
    for module in sorted({t.module for t in types}):
        print_text(f"{module or 'running graph'}:")
        for name in sorted({t.name for t in types if t.module == module}):
            print_text(f"  {name}")


@app.command("show")
def show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="As in ContactSample or msgs.contact:ContactSample.",
            autocompletion=completion.types,
            show_default=False,
        ),
    ],
    *,
    as_: Annotated[Literal["struct", "ros", "json-schema"], typer.Option("--as", help="Form.")] = "struct",
    workspace: WorkspaceOption = None,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print a type as a struct, .msg text or JSON Schema."""
    from palp_core.cli.node.interface_source import elsewhere, known_types
    from palp_core.cli.node.interface_text import ros_form, struct_form
    from palp_core.graph.problems import hint

    types = known_types(graph, workspace)
    module, _, wanted = name.rpartition(":")
    wanted = wanted.rpartition("/")[2]
    found = [t for t in types if t.name == wanted and (not module or not t.module or t.module == module)]
    if not found:
        raise GraphError(
            f"no type '{name}'{hint(wanted, {t.name for t in types})}{elsewhere(graph, workspace)}"
        )
    if len({t.type_hash for t in found}) > 1:
        where = ", ".join(f"{t.module}:{t.name}" for t in found)
        raise GraphError(f"there are several types '{wanted}': {where}; name one of these")
    kind = found[0]
    if as_json:
        print_json(
            {"name": kind.name, "module": kind.module, "hash": kind.type_hash, "schema": kind.json_schema}
        )
    elif as_ == "json-schema":
        print_text(json.dumps(kind.json_schema, indent=2))
    else:
        print_text((struct_form if as_ == "struct" else ros_form)(kind.json_schema))
