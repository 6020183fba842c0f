"""``palp interface``: types of messages and services, of the running graph or of a workspace."""

import importlib
import itertools
import json
import pkgutil
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from palp_core.cli import completion
from palp_core.cli.options import Call, argument, graph_verb, option
from palp_core.errors import GraphError
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.discovery.choice import meant
from palp_core.graph.discovery.run_directory import running
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_reader import (
    JsonSchema,
    fields_of,
    items_of,
    ros_text,
)
from palp_core.graph.node.loading import enter_workspace
from palp_core.graph.problems import hint

BUILTIN = "palp_core.graph.messages.builtin"
ASK_S = 2.0
app = typer.Typer()

WorkspaceOption = Annotated[
    Path | None, option("Folder with msgs/; default: the running graph's, else here.", metavar="DIR")
]


class KnownType(NamedTuple):
    """A type of message, request or reply; ``module`` is empty where only the graph's record is known."""

    name: str
    module: str
    type_hash: str
    json_schema: dict[str, Any]


@app.command("list")
@graph_verb()
def list_interfaces(call: Call, *, workspace: WorkspaceOption = None) -> None:
    """List the types of the running graph or of a workspace."""
    types = sorted(_known_types(call, workspace)[0], key=lambda t: (t.module, t.name))
    lines = []
    for module, of_module in itertools.groupby(types, lambda t: t.module):
        lines += [f"{module or 'running graph'}:", *dict.fromkeys(f"  {t.name}" for t in of_module)]
    call.show([{"name": t.name, "module": t.module, "hash": t.type_hash} for t in types], lines)


@app.command("show")
@graph_verb()
def show(
    call: Call,
    name: Annotated[
        str, argument("As in ContactSample or msgs.contact:ContactSample.", "NAME", complete=completion.types)
    ],
    *,
    as_json_schema: Annotated[bool, option("As JSON Schema.", "--json-schema")] = False,
    workspace: WorkspaceOption = None,
) -> None:
    """Print a type as .msg text or JSON Schema."""
    types, searched = _known_types(call, workspace)
    module, _, wanted = name.rpartition(":")
    wanted = wanted.rpartition("/")[2]
    found = [t for t in types if t.name == wanted and (not module or not t.module or t.module == module)]
    if not found:
        known = {kind.name for kind in types}
        raise GraphError(f"no type '{name}'{hint(wanted, known)}{searched}")
    if len({t.type_hash for t in found}) > 1:
        where = ", ".join(f"{t.module}:{t.name}" for t in found)
        raise GraphError(f"there are several types '{wanted}': {where}; name one of these")
    kind = found[0]
    schema = kind.json_schema
    text = json.dumps(schema, indent=2) if as_json_schema else "\n".join(_ros_lines(schema, ""))
    call.show(
        {"name": kind.name, "module": kind.module, "hash": kind.type_hash, "schema": kind.json_schema}, [text]
    )


def _known_types(call: Call, workspace: Path | None) -> tuple[list[KnownType], str]:
    """Return the types of the running graph, or those of a workspace if that is named or none runs.

    And where they were looked for, for an error; "" where a workspace is named.
    """
    if workspace is not None:
        if not (workspace / "msgs").is_dir():
            raise GraphError(f"--workspace {workspace}: no folder msgs in it")
        return [*_of_workspace(workspace), *_of_module(BUILTIN)], ""
    advice = "name a workspace with --workspace DIR"
    if call.name is not None or meant(running(), None):
        return _of_graph(call.graph), f" (looked in: the running graph; {advice})"
    folder = find_workspace(Path("x").resolve())
    where = f"{folder / 'msgs'}, palp itself"
    if not (folder / "msgs").is_dir():
        where = f"palp itself, as {folder} has no folder msgs and no graph runs; {advice}"
    return [*_of_workspace(folder), *_of_module(BUILTIN)], f" (looked in: {where})"


def _of_graph(graph: RunningGraph) -> list[KnownType]:
    found = {
        (topic.type, topic.type_hash): KnownType(topic.type, "", topic.type_hash, topic.json_schema)
        for topic in graph.record.topics
    }
    for reply in graph.ask_all("schemas", timeout_s=ASK_S).replies.values():
        for port in reply["ports"].values():
            for kind in port["types"]:
                known = KnownType(kind["name"], "", kind["type_hash"], kind["json_schema"])
                found.setdefault((known.name, known.type_hash), known)
    return list(found.values())


def _of_workspace(folder: Path) -> list[KnownType]:
    enter_workspace(str(folder.resolve()))
    names = [f"msgs.{module.name}" for module in pkgutil.iter_modules([str(folder / "msgs")])]
    return [kind for name in sorted(names) for kind in _of_module(name)]


def _of_module(name: str) -> list[KnownType]:
    try:
        module = importlib.import_module(name)
    except Exception as error:
        raise GraphError(f"{name} cannot be imported: {type(error).__name__}: {error}") from error
    classes = [value for value in vars(module).values() if isinstance(value, type)]
    own = [c for c in classes if issubclass(c, Message) and c is not Message and c.__module__ == name]
    schemas = [schema_of(c) for c in own]
    return [KnownType(s.name, name, s.hash_text, s.json_schema) for s in schemas]


def _ros_lines(schema: JsonSchema, indent: str) -> list[str]:
    """Return the type as ROS 2 prints it: fields of nested messages are indented."""
    lines = []
    for line, field in zip(ros_text(schema).splitlines(), fields_of(schema).values(), strict=True):
        lines += [indent + line, *_ros_lines(items_of(field) or field, indent + "\t")]
    return lines
