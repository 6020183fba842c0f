"""What a launch file says, with its arguments filled in, before anything is known of the node classes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.graph.description.arguments import Argument, show
from palp_core.graph.description.yaml_tree import UNKNOWN
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.spec import NodeSpec, action_of
from palp_core.graph.problems import Mark, Problem

if TYPE_CHECKING:
    from palp_core.graph.description.node_class import NodeClass, NodePort  # they take numpy


@dataclass(frozen=True)
class Located:
    """A value, where it is written, whether it is an argument's default, and which argument's it is."""

    value: Any
    mark: Mark
    defaulted: bool = False
    argument: str = ""


class Wire(msgspec.Struct, frozen=True):
    """An input as the launch file states it: what it reads, and what it asks for.

    Attributes:
        node: What it reads is this node's ``port``; "" where the messages come from outside the graph.
    """

    node: str
    port: str
    stated: dict[str, Any] = {}
    external: bool = False

    def requested(self, declared: Qos) -> Qos:
        """Return what the reader requests: its port's declaration with what the launch file states."""
        return Qos(**{name: getattr(declared, name) for name in Qos.__struct_fields__} | self.stated)


@dataclass(frozen=True)
class GraphNode:
    """One node of a launch file, with its arguments filled in.

    Attributes:
        places: Of each input the place of its name, and of what it reads.
        params: Parameters given, each with its place and the argument or shared parameter that it is.
        offered: Parameters that count only if its class has them.
        own: Its class is the caller's, named in place of a choice.
        answer: What its class declares; None until the class has been asked.
    """

    spec: NodeSpec
    mark: Mark
    run_mark: Mark
    inputs: dict[str, Wire]
    places: Mapping[str, tuple[Mark, Mark]] = field(default_factory=dict)
    params: dict[str, Located] = field(default_factory=dict)
    offered: frozenset[str] = frozenset()
    selected: bool = False
    own: bool = False
    complete: bool = True
    answer: NodeClass | None = None

    @property
    def declared(self) -> NodeClass:
        """What its class declares; it must have been asked."""
        assert self.answer is not None
        return self.answer

    def __str__(self) -> str:
        return f"node '{self.spec.name}' ({self.declared.run.rpartition(':')[2]})"

    def given(self, params: Mapping[str, Located], offered: Iterable[str]) -> GraphNode:
        """Return the node with other parameters, of which these count only if its class has them."""
        values = {name: located.value for name, located in params.items()}
        spec = msgspec.structs.replace(self.spec, params=values)
        return replace(self, spec=spec, params=dict(params), offered=frozenset(offered))

    def renamed(self, names: Mapping[str, str]) -> GraphNode:
        """Return the node, and the wires from others, with new names of nodes."""
        wires = {
            port: msgspec.structs.replace(wire, node=names.get(wire.node, wire.node))
            for port, wire in self.inputs.items()
        }
        name = names.get(self.spec.name, self.spec.name)
        return replace(self, spec=msgspec.structs.replace(self.spec, name=name), inputs=wires)

    def ports(self, *kinds: str) -> dict[str, NodePort]:
        """Return the ports of these kinds that its class declares, by name; not the parts of its actions."""
        own = self.declared.ports.items()
        return {name: port for name, port in own if port.kind in kinds and not action_of(name)}

    def place_of(self, name: str) -> Mark:
        """Return the place of what an input reads."""
        return self.places[name][1] if name in self.places else self.mark

    @property
    def wires(self) -> dict[str, Wire]:
        """Wires by port, that of an action as one for each of its parts."""
        found = {}
        for name, wire in self.inputs.items():
            port = self.declared.ports.get(name)
            if port is None or port.kind != "action_client":
                found[name] = wire
                continue
            for own in (own for own in self.declared.ports if action_of(own) == name):
                found[own] = msgspec.structs.replace(wire, port=wire.port + own.removeprefix(name))
        return found


@dataclass(frozen=True)
class LaunchFile:
    """A launch file and what it includes.

    Attributes:
        nodes: By name, in the file's order; those of an included file in place of its ``include``.
        variants: The same with each other branch of each selection.
        shared: Shared parameters by name, but those of namespaces.
        unread: Nodes of which it is not known what they run, after a mistake.
        remarks: What it leaves out of the files that it includes.
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
    variants: tuple[dict[str, GraphNode], ...] = ()
    shared: dict[str, Located] = field(default_factory=dict)
    unread: frozenset[str] = frozenset()
    listen: str = ""
    view: Located | None = None
    checkpoint: Located | None = None
    remarks: tuple[str, ...] = ()


def find_workspace(path: Path) -> Path:
    """Return the nearest folder above a launch file that has ``nodes/``, else the file's own folder."""
    folder = path.resolve().parent
    return next((parent for parent in [folder, *folder.parents] if (parent / "nodes").is_dir()), folder)


def find_overlay(path: Path) -> Path:
    """Return the workspace of a launch file that is installed: the one that one is in lies over it."""
    try:
        here = find_workspace(Path.cwd() / "file")
    except FileNotFoundError:  # where one is was removed
        return find_workspace(path)
    return here if (here / "nodes").is_dir() else find_workspace(path)


def arguments_text(description: LaunchFile) -> str:
    """Return what a launch file takes, in ROS 2's words."""
    lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
    for argument in description.arguments.values():
        lines += ["", f"    '{argument.name}':"]
        text = argument.help or "no description given"
        if argument.choices:
            text = f"{text.rstrip('.')}. Valid choices are: [{', '.join(map(show, argument.choices))}]"
            text += ", or a class of yours: MODULE:CLASS or FILE.py:CLASS" if argument.or_class else ""
        lines.append(f"        {text}")
        if argument.default is not UNKNOWN:
            lines.append(f"        (default: {show(argument.default)})")
        for choice, defaults in argument.sets.items():
            set_by = ", ".join(f"{name}:={given.value}" for name, given in defaults.items())
            lines.append(f"        ({choice} sets: {set_by})")
    if len(lines) == 1:
        lines += ["", "    No arguments."]
    if description.shared:
        lines += ["", "Shared parameters (pass them as 'shared.<name>:=<value>'):", ""]
        lines += [f"    {name}: {show(located.value)}" for name, located in description.shared.items()]
    return "\n".join(lines) + "\n"
