"""The key ``checkpoint`` of a launch file: where nodes are written down, when, and which."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import msgspec

from palp_core.graph.problems import Mark, Problems, hint


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
