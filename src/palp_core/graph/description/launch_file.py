"""What a launch file says, with its arguments filled in, before anything is known of the node classes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palp_core.graph.description.arguments import Argument, show
from palp_core.graph.description.substitution import UNKNOWN
from palp_core.graph.messages.qos import Qos
from palp_core.graph.problems import Mark, Problem


@dataclass(frozen=True)
class Located:
    """A value and where it is written."""

    value: Any
    mark: Mark


@dataclass(frozen=True)
class InputEntry:
    """One wire, from the reader's side.

    Attributes:
        mark: Where the input is named.
        source_mark: Where the publisher is named.
        node: Publishing node.
        port: Its port.
        stated: Quality of service that the launch file asks for, by name.
        action: What the supervisor does when the edge breaks its promise: ``warn``, ``restart``,
            ``shutdown``.
        external: The messages come from outside the graph; then there is no node and no port.
    """

    mark: Mark
    source_mark: Mark
    node: str
    port: str
    stated: dict[str, Any]
    action: str = "warn"
    external: bool = False

    def requested(self, declared: Qos) -> Qos:
        """Return what the reader requests: its port's declaration with what the launch file states."""
        return Qos(**{name: getattr(declared, name) for name in Qos.__struct_fields__} | self.stated)


@dataclass(frozen=True)
class Variant:
    """A node under one assignment of the arguments that select its parts.

    Attributes:
        assignment: Branch per selecting argument; empty when nothing is selected.
        run: ``module:Class`` or ``/absolute/path.py:Class``.
        params: Parameters by name.
        inputs: Wires by port.
    """

    assignment: dict[str, str]
    run: Located
    params: dict[str, Located]
    inputs: dict[str, InputEntry]

    def agrees(self, other: Variant) -> bool:
        """Tell whether both can be present in one graph: they share no argument with different branches."""
        return all(other.assignment.get(name, branch) == branch for name, branch in self.assignment.items())


@dataclass(frozen=True)
class Restart:
    """When a node that fails is started again."""

    when: str = "never"
    max_restarts: int = 3
    backoff_s: float = 0.2


@dataclass(frozen=True)
class GraphNode:
    """One node of a launch file.

    Attributes:
        name: Running name.
        mark: Where it is named.
        variants: Every variant; one when nothing is selected.
        present: The variant that the arguments pick; None when a mistake hides it.
        restart: When it is started again.
        shutdown_on_exit: Its end ends the run.
        complete: Its description has no mistake of its own.
        cpus: Cores its process may run on; empty: all.
        realtime_priority: SCHED_FIFO priority; 0: none.
        joined: Its process is on another host and joins from there.
    """

    name: str
    mark: Mark
    variants: tuple[Variant, ...]
    present: Variant | None
    restart: Restart
    shutdown_on_exit: bool
    complete: bool
    cpus: tuple[int, ...] = ()
    realtime_priority: int = 0
    joined: bool = False


@dataclass(frozen=True)
class LaunchFile:
    """A launch file and what it includes.

    Attributes:
        file: The launch file, as given.
        workspace: Folder that goes first on the nodes' module path.
        mark: Where the nodes begin.
        graph: Name of the graph.
        clock: ``sim`` or ``wall``.
        seed: Of the graph's random numbers.
        arguments: Declared arguments.
        values: Value of each argument.
        nodes: Nodes, the included ones first, in the files' order.
        report: ``module:function`` to run at the end.
        problems: Mistakes found so far.
        listen: ``tcp://HOST:PORT`` where other hosts may call; "" for nowhere.
    """

    file: Path
    workspace: Path
    mark: Mark
    graph: str
    clock: str
    seed: int
    arguments: dict[str, Argument]
    values: dict[str, Any]
    nodes: dict[str, GraphNode]
    report: Located | None
    problems: tuple[Problem, ...]
    listen: str = ""


def find_workspace(path: Path) -> Path:
    """Return the nearest folder above a launch file that has ``nodes/``, else the file's own folder."""
    folder = path.resolve().parent
    return next((parent for parent in [folder, *folder.parents] if (parent / "nodes").is_dir()), folder)


def arguments_text(description: LaunchFile) -> str:
    """Return what a launch file takes, in ROS 2's words."""
    lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
    for argument in description.arguments.values():
        lines += ["", f"    '{argument.name}':"]
        text = argument.help or "no description given"
        if argument.choices:
            text = f"{text.rstrip('.')}. Valid choices are: [{', '.join(map(show, argument.choices))}]"
        lines.append(f"        {text}")
        if argument.default is not UNKNOWN:
            lines.append(f"        (default: {show(argument.default)})")
    if len(lines) == 1:
        lines += ["", "    No arguments."]
    return "\n".join(lines) + "\n"
