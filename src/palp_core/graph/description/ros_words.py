"""ROS 2's words on the command line of ``palp launch``: parameters, parameter files, remaps.

A word is an argument, ``name:=value``, or one of these, each of which is told from the others by its form:
``node:parameter:=value``, ``--params-file=FILE``, ``--remap=/node/port:=/node/port``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from palp_core.graph.description.launch_file import GraphNode, InputEntry
from palp_core.graph.description.parameter_file import EVERY_NODE, HEADING, section_entries
from palp_core.graph.description.yaml_tree import Mapping, parse_tree, plain_tree, read_tree
from palp_core.graph.problems import GraphProblems, Mark, Problems, hint

PARAMS_FILE, REMAP = "--params-file=", "--remap="
_PARAMETER = re.compile(r"(?P<node>/?[A-Za-z]\w*):(?P<name>[A-Za-z_][\w.]*):=(?P<value>.*)", re.S)
_REMAP = re.compile(
    r"(?:(?P<reader>[A-Za-z]\w*):)?/?(?P<node>[A-Za-z]\w*)/(?P<port>[A-Za-z]\w*)"
    r":=/?(?P<new_node>[A-Za-z]\w*)/(?P<new_port>[A-Za-z]\w*)"
)

Nodes = dict[str, list[GraphNode]]


class RosWords(NamedTuple):
    """What a command line says.

    Attributes:
        arguments: Words of the form ``name:=value``, and whatever is none of ROS 2's.
        parameters: Words ``node:parameter:=value``.
        files: Parameter files, in their order.
        remaps: What ``--remap`` says.
    """

    arguments: list[str]
    parameters: list[str]
    files: list[str]
    remaps: list[str]


def sort_words(words: Sequence[str]) -> RosWords:
    """Tell ROS 2's words from arguments.

    >>> sort_words(["trials:=5", "policy:ring_mm:=8.0"]).parameters
    ['policy:ring_mm:=8.0']
    """
    found = RosWords([], [], [], [])
    for word in words:
        if word.startswith(PARAMS_FILE):
            found.files.append(word.removeprefix(PARAMS_FILE))
        elif word.startswith(REMAP):
            found.remaps.append(word.removeprefix(REMAP))
        elif _PARAMETER.fullmatch(word):
            found.parameters.append(word)
        else:
            found.arguments.append(word)
    return found


def apply_words(nodes: Nodes, words: RosWords, caller: Mark, problems: Problems) -> Nodes:
    """Return the nodes with what a command line says; later words win, and words over files, as in ROS 2.

    Args:
        nodes: Of the launch file.
        words: Of the command line.
        caller: Where a mistake on the command line is reported.
        problems: Takes the mistakes.
    """
    for file in words.files:
        nodes = _with_file(nodes, Path(file), caller, problems)
    for word in words.parameters:
        match = _PARAMETER.fullmatch(word)
        assert match is not None
        name = match["node"].removeprefix("/")
        value = _value(match["value"], word, caller, problems)
        if name in nodes:
            nodes = _with_parameter(nodes, name, match["name"], value, caller)
        else:
            problems.add(caller, f"'{word}' on the command line: no node '{name}'{hint(name, nodes)}")
    for word in words.remaps:
        nodes = _remapped(nodes, word, caller, problems)
    return nodes


def _value(text: str, word: str, caller: Mark, problems: Problems) -> Any:
    try:
        tree = parse_tree(text, word, problems)
    except GraphProblems as error:
        problems.add(caller, f"'{word}' on the command line: {error.problems[0].message}")
        return None
    return "" if tree is None else plain_tree(tree)


def _with_parameter(nodes: Nodes, name: str, parameter: str, value: Any, mark: Mark) -> Nodes:
    """Return the nodes with one parameter given, in whatever branch of a selection."""

    def changed(node: GraphNode) -> GraphNode:
        return replace(
            node,
            spec=msgspec.structs.replace(node.spec, params={**node.spec.params, parameter: value}),
            param_marks={**node.param_marks, parameter: mark},
            defaulted=node.defaulted - {parameter},
            offered=node.offered - {parameter},
            arguments={key: text for key, text in node.arguments.items() if key != parameter},
        )

    return {**nodes, name: [changed(node) if node.present else node for node in nodes[name]]}


def _with_file(nodes: Nodes, path: Path, caller: Mark, problems: Problems) -> Nodes:
    """Return the nodes with what a parameter file of ROS 2's says."""
    try:
        tree = read_tree(path, problems)
    except GraphProblems as error:
        problems.add(caller, f"--params-file {path}: {error.problems[0].message}")
        return nodes
    if not isinstance(tree, Mapping):
        problems.add(tree.mark, f"a parameter file is a mapping, as in /node: {{{HEADING}: {{name: value}}}}")
        return nodes
    sections = sorted(tree.items.items(), key=lambda item: "*" not in item[0])  # a node's own go last
    sections.sort(key=lambda item: item[0] != EVERY_NODE)
    for pattern, entry in sections:
        for parameter, value in section_entries(pattern, entry, problems).items():
            found = [name for name in nodes if _fits(pattern, name, parameter, nodes[name])]
            for name in found:
                nodes = _with_parameter(nodes, name, parameter, plain_tree(value.value), value.mark)
            if not found and "*" in pattern:
                problems.add(
                    value.mark,
                    f"no node of '{pattern}' is given '{parameter}' in the launch file; name the node",
                )
        if "*" not in pattern and pattern.removeprefix("/") not in nodes:
            problems.add(entry.mark, f"no node '{pattern}'{hint(pattern, [f'/{name}' for name in nodes])}")
    return nodes


def _fits(pattern: str, name: str, parameter: str, node: list[GraphNode]) -> bool:
    """Tell whether an entry is for a node; by a wildcard it reaches those that have the parameter stated."""
    if "*" not in pattern:
        return pattern.removeprefix("/") == name
    stated = any(parameter in one.spec.params for one in node if one.present)
    return stated and fnmatchcase(name, pattern.removeprefix("/").replace("**", "*"))


def _remapped(nodes: Nodes, word: str, caller: Mark, problems: Problems) -> Nodes:
    """Return the nodes with what read one port reading another."""
    match = _REMAP.fullmatch(word)
    if match is None:
        problems.add(
            caller,
            f"'{word}' on the command line is no remap; write /node/port:=/node/port, or reader: and that "
            "for one reader; a node is named by the launch file",
        )
        return nodes
    old, new = (match["node"], match["port"]), (match["new_node"], match["new_port"])
    reader = match["reader"]
    if reader is not None and reader not in nodes:
        problems.add(caller, f"'{word}' on the command line: no node '{reader}'{hint(reader, nodes)}")
        return nodes
    if new[0] not in nodes:
        problems.add(caller, f"'{word}' on the command line: no node '{new[0]}'{hint(new[0], nodes)}")
        return nodes
    count = 0

    def moved(wire: InputEntry) -> InputEntry:
        nonlocal count
        if (wire.node, wire.port) != old:
            return wire
        count += 1
        return replace(wire, node=new[0], port=new[1], source_mark=caller)

    found = {
        name: [
            replace(node, inputs={port: moved(wire) for port, wire in node.inputs.items()})
            for node in assigned
        ]
        if reader in (None, name) and name != new[0]
        else assigned
        for name, assigned in nodes.items()
    }
    if not count:
        who = "nobody reads" if reader is None else f"{reader} does not read"
        problems.add(caller, f"'{word}' on the command line: {who} /{old[0]}/{old[1]}")
    return found
