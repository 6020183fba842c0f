"""Log levels by node, for ``palp launch``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, get_args

import typer

from palp_core.cli.options import Level
from palp_core.errors import GraphError
from palp_core.graph.problems import hint

LogLevelOption = Annotated[
    list[str] | None,
    typer.Option(
        "--log-level",
        metavar="[NODE:=]LEVEL",
        help="The least of what nodes, or one node, log that is shown here. Repeatable; default: warning.",
    ),
]


def log_levels(words: Sequence[str] | None) -> tuple[str, dict[str, str]]:
    """Return the level of all nodes, and of those that have their own.

    Raises:
        GraphError: A level that there is not.

    >>> log_levels(["error", "policy:=debug"])
    ('error', {'policy': 'debug'})
    """
    default, nodes = "warning", dict[str, str]()
    for word in words or ():
        node, own, level = word.rpartition(":=")
        if level.lower() not in get_args(Level):
            raise GraphError(f"--log-level {word}: no level '{level}'{hint(level, get_args(Level))}")
        if own:
            nodes[node.removeprefix("/")] = level.lower()
        else:
            default = level.lower()
    return default, nodes


def check_levels(nodes: Sequence[str], known: Sequence[str]) -> None:
    """See that the nodes that have a level of their own are there.

    Raises:
        GraphError: One is not.
    """
    for node in nodes:
        if node not in known:
            raise GraphError(f"--log-level {node}:=...: no node '{node}'{hint(node, known)}")
