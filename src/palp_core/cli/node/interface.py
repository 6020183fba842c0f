"""``palp interface``: types of messages and services, of the running graph or of a workspace."""

import importlib
import itertools
import json
import pkgutil
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import typer

from palp_core.cli import completion
from palp_core.cli.options import Call, argument, graph_verb, option
from palp_core.errors import GraphError
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.discovery.choice import meant
from palp_core.graph.discovery.run_directory import running
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import json_schema, schema_of
from palp_core.graph.messages.schema_reader import (
    FieldKind,
    JsonSchema,
    fields_of,
    items_of,
    kind_of,
    nested,
    ros_text,
    unit_comment,
)
from palp_core.graph.node.loading import enter_workspace
from palp_core.graph.problems import hint

BUILTIN = "palp_core.graph.messages.builtin"
ASK_S = 2.0
_STRUCT = {
    FieldKind.BOOL: "bool",
    FieldKind.INT: "int",
    FieldKind.FLOAT: "float",
    FieldKind.STRING: "str",
    FieldKind.BYTES: "bytes",
    FieldKind.ARRAY: "NDArray[float64]",
}

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
    types = sorted(_known_types(call, workspace), key=lambda t: (t.module, t.name))
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
    as_: Annotated[Literal["struct", "ros", "json-schema"], option("Form.", "--as")] = "struct",
    workspace: WorkspaceOption = None,
) -> None:
    """Print a type as a struct, .msg text or JSON Schema."""
    types = _known_types(call, workspace)
    module, _, wanted = name.rpartition(":")
    wanted = wanted.rpartition("/")[2]
    found = [t for t in types if t.name == wanted and (not module or not t.module or t.module == module)]
    if not found:
        known = {kind.name for kind in types}
        raise GraphError(f"no type '{name}'{hint(wanted, known)}{_searched(call, workspace)}")
    if len({t.type_hash for t in found}) > 1:
        where = ", ".join(f"{t.module}:{t.name}" for t in found)
        raise GraphError(f"there are several types '{wanted}': {where}; name one of these")
    kind = found[0]
    if as_ == "json-schema":
        text = json.dumps(kind.json_schema, indent=2)
    else:
        text = (struct_form if as_ == "struct" else ros_form)(kind.json_schema)
    call.show(
        {"name": kind.name, "module": kind.module, "hash": kind.type_hash, "schema": kind.json_schema}, [text]
    )


def _known_types(call: Call, workspace: Path | None) -> list[KnownType]:
    """Return the types of the running graph, or those of a workspace if that is named or none runs."""
    if workspace is not None and not (workspace / "msgs").is_dir():
        raise GraphError(f"--workspace {workspace}: no folder msgs in it")
    if workspace is None and (call.name is not None or meant(running(), None)):
        return _of_graph(call.graph)
    folder = workspace if workspace is not None else find_workspace(Path("x").resolve())
    return [*_of_workspace(folder), *_of_module(BUILTIN)]


def _searched(call: Call, workspace: Path | None) -> str:
    """Return where a type that is not known was looked for; "" where a workspace is named."""
    if workspace is not None:
        return ""
    if call.name is not None or meant(running(), None):
        return " (looked in: the running graph; name a workspace with --workspace DIR)"
    folder = find_workspace(Path("x").resolve())
    if (folder / "msgs").is_dir():
        return f" (looked in: {folder / 'msgs'}, palp itself)"
    return (
        f" (looked in: palp itself, as {folder} has no folder msgs and no graph runs; "
        "name a workspace with --workspace DIR)"
    )


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
    return [KnownType(s.name, name, s.hash_text, json_schema(s)) for s in schemas]


def struct_form(schema: JsonSchema) -> str:
    """Return the type and those nested in it as classes, the nested first."""
    return "\n\n\n".join(_class_text(one) for one in [*nested(schema), schema])


def _class_text(schema: JsonSchema) -> str:
    lines = [f"class {schema['title']}(Message):"]
    if schema.get("description"):
        lines += [f'    """{schema["description"]}"""', ""]
    for name, field in fields_of(schema).items():
        lines.append(f"    {name}: {_struct_type(field)}{unit_comment(field)}")
    return "\n".join(lines)


def _struct_type(field: JsonSchema) -> str:
    kind = kind_of(field)
    if kind is FieldKind.LIST:
        return f"list[{_struct_type(items_of(field))}]"
    return str(field["title"]) if kind is FieldKind.MESSAGE else _STRUCT[kind]


def ros_form(schema: JsonSchema) -> str:
    """Return the type as ROS 2's ``.msg`` text, fields of nested messages indented, as ROS 2 prints them."""
    return "\n".join(_ros_lines(schema, ""))


def _ros_lines(schema: JsonSchema, indent: str) -> list[str]:
    lines = []
    for line, field in zip(ros_text(schema).splitlines(), fields_of(schema).values(), strict=True):
        lines += [indent + line, *_ros_lines(items_of(field) or field, indent + "\t")]
    return lines
