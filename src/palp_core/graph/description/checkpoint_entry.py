"""The key ``checkpoint`` of a launch file: where nodes are written down, when, and which."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import msgspec

from palp_core.graph.description.arguments import unknown_keys
from palp_core.graph.description.input_reader import flat
from palp_core.graph.description.keys import CHECKPOINT, WIRE
from palp_core.graph.description.substitution import Scope, evaluate
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Sequence, Tree
from palp_core.graph.description.yaml_tree import Mapping as TreeMapping
from palp_core.graph.node.spec import topic
from palp_core.graph.problems import Mark, Problems, hint

_FORM = "write {file: $(var out)/checkpoint, after: node/port, nodes: [node, ...]}"


class CheckpointEntry(msgspec.Struct, frozen=True, kw_only=True):
    """What a launch file says of checkpoints.

    Attributes:
        file: Where the latest one is; relative to where one is.
        after: Topic; a message of it says that one is due.
        nodes: Those whose state is kept.
    """

    file: str
    after: str
    nodes: list[str]


def read_checkpoint(
    entry: Entry | None, scope: Scope, problems: Problems
) -> tuple[CheckpointEntry, Mark] | None:
    """Return what the key says and where, or None after reporting what is wrong with it."""
    if entry is None:
        return None
    if not isinstance(entry.value, TreeMapping):
        problems.add(entry.value.mark, f"checkpoint must be a mapping; {_FORM}")
        return None
    fields = unknown_keys(entry.value, CHECKPOINT, "checkpoint", problems)
    for key in ("file", "after", "nodes"):
        if key not in fields:
            problems.add(entry.mark, f"checkpoint does not state its {key}; {_FORM}")
    file = _file(fields["file"].value, scope, problems) if "file" in fields else None
    after = _topic(fields["after"].value, scope, problems) if "after" in fields else None
    nodes = _names(fields["nodes"].value, scope, problems) if "nodes" in fields else []
    if file is None or after is None:
        return None
    return CheckpointEntry(file=file, after=after, nodes=nodes), entry.mark


def _file(tree: Tree, scope: Scope, problems: Problems) -> str | None:
    value = evaluate(tree, scope, problems)
    if value is UNKNOWN or (isinstance(value, str) and value):
        return None if value is UNKNOWN else value
    problems.add(tree.mark, f"file of checkpoint is '{flat(value)}'; it must be a path")
    return None


def _topic(tree: Tree, scope: Scope, problems: Problems) -> str | None:
    value = evaluate(tree, scope, problems)
    if value is UNKNOWN:
        return None
    if not isinstance(value, str) or WIRE.fullmatch(value) is None:
        problems.add(tree.mark, f"after of checkpoint is '{flat(value)}'; write node/port")
        return None
    return topic(*value.split("/"))


def _names(tree: Tree, scope: Scope, problems: Problems) -> list[str]:
    values: Any = evaluate(tree, scope, problems) if isinstance(tree, Sequence) else None
    if values is UNKNOWN:
        return []
    if not isinstance(values, list) or not values or not all(isinstance(name, str) for name in values):
        problems.add(tree.mark, "nodes of checkpoint must be a list of names, as in [experiment, policy]")
        return []
    return values


def check_checkpoint(
    found: tuple[CheckpointEntry, Mark] | None,
    topics: Collection[str],
    readers: Mapping[str, Collection[str]],
    here: Collection[str],
    problems: Problems,
) -> CheckpointEntry | None:
    """Check the key against the graph.

    Args:
        found: What the file says.
        topics: All of the graph.
        readers: Names of the nodes that read a topic.
        here: Names of the nodes whose processes are the launcher's.
        problems: Receives the mistakes.
    """
    if found is None:
        return None
    entry, mark = found
    if entry.after not in topics:
        known = [name.removeprefix("/") for name in topics]
        asked = entry.after.removeprefix("/")
        problems.add(mark, f"checkpoint: no output '{asked}'{hint(asked, known)}")
        return entry
    concerned = {entry.after.split("/")[1], *readers.get(entry.after, ())}
    for name in entry.nodes:
        if name not in here:
            problems.add(mark, f"checkpoint: no node '{name}' on this host{hint(name, here)}")
        elif name not in concerned:
            asked = entry.after.removeprefix("/")
            text = f"node '{name}' neither publishes nor reads {asked}, and cannot tell when it is due"
            problems.add(mark, f"checkpoint: {text}")
    return entry
