"""Where types come from: the running graph's own record, else a workspace's ``msgs`` and palp itself."""

import importlib
import pkgutil
from pathlib import Path
from typing import Any, NamedTuple

from palp_core.cli.running import find_graph
from palp_core.errors import GraphError
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.discovery.choice import meant
from palp_core.graph.discovery.run_directory import running
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import json_schema, schema_of
from palp_core.graph.node.loading import enter_workspace

BUILTIN = "palp_core.graph.messages.builtin"
ASK_S = 2.0


class KnownType(NamedTuple):
    """A type of message, request or reply; ``module`` is empty where only the graph's record is known."""

    name: str
    module: str
    type_hash: str
    json_schema: dict[str, Any]


def known_types(graph: str | None, workspace: Path | None) -> list[KnownType]:
    """Return the types of the running graph, or those of a workspace if that is named or none runs.

    Raises:
        GraphError: The workspace has no ``msgs``, a module of it cannot be imported, or no graph of that name
            runs.
    """
    if workspace is not None and not (workspace / "msgs").is_dir():
        raise GraphError(f"--workspace {workspace}: no folder msgs in it")
    if workspace is None and (graph is not None or meant(running(), None)):
        return _of_graph(find_graph(graph))
    folder = workspace if workspace is not None else find_workspace(Path("x").resolve())
    return [*_of_workspace(folder), *_of_module(BUILTIN)]


def elsewhere(graph: str | None, workspace: Path | None) -> str:
    """Return where else a type may be, to end the words that it is not known; "" where a workspace is."""
    if workspace is not None:
        return ""
    if graph is not None or meant(running(), None):
        return " (asked: the running graph; --workspace DIR looks at the files of a workspace instead)"
    folder = find_workspace(Path("x").resolve())
    if (folder / "msgs").is_dir():
        return f" (looked in: {folder / 'msgs'}, palp itself)"
    return (
        f" (looked in: palp itself, as {folder} has no folder msgs and no graph runs; "
        "go to a workspace, name one with --workspace DIR, or launch its graph)"
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
    if not (folder / "msgs").is_dir():
        return []
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
