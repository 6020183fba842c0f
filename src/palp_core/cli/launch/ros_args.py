"""ROS 2's habits at ``palp launch``: remaps, parameter files, levels by node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, get_args

import typer

from palp_core.cli.options import Level
from palp_core.errors import GraphError
from palp_core.graph.problems import hint

RemapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--remap",
        "-r",
        metavar="/A/X:=/B/Y",
        help="Who reads port x of node a reads y of b; with node: before it only that node does. Repeatable.",
    ),
]
ParamsFileOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--params-file",
        metavar="FILE",
        help="Parameters of nodes, in ROS 2's form. Repeatable, the last counts.",
    ),
]
ParamOption = Annotated[
    list[str] | None,
    typer.Option("--param", "-p", metavar="NODE:NAME:=VALUE", help="A parameter of a node. Repeatable."),
]
RosArgsOption = Annotated[
    bool, typer.Option("--ros-args", help="ROS 2's word before -p and -r; it may be left out.")
]
LogLevelOption = Annotated[
    list[str] | None,
    typer.Option(
        "--log-level",
        metavar="[NODE:=]LEVEL",
        help="The least of what nodes, or one node, log that is shown here. Repeatable; default: warning.",
    ),
]


def launch_words(
    arguments: Sequence[str],
    remaps: Sequence[str] | None,
    files: Sequence[Path] | None,
    params: Sequence[str] | None = None,
) -> list[str]:
    """Return all that is said about the launch file, as one list of words.

    Raises:
        GraphError: A parameter is not of the form ``NODE:NAME:=VALUE``.
    """
    for word in params or ():
        name, sign, _ = word.partition(":=")
        if not (sign and ":" in name):
            raise GraphError(f"-p {word}: write -p NODE:NAME:=VALUE")
    return [
        *arguments,
        *(params or ()),
        *(f"--params-file={file}" for file in files or ()),
        *(f"--remap={remap}" for remap in remaps or ()),
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
