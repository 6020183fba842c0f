"""``palp param``: the parameters of running nodes, in ROS 2's words and file form."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.options import GraphOption, JsonOption, NodeArgument, OptionalNodeArgument, TimeoutOption
from palp_core.cli.output import note, print_json, print_text, yaml_text
from palp_core.cli.running import find_graph
from palp_core.errors import GraphError

app = typer.Typer()

NameArgument = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="Of the parameter.", autocompletion=completion.parameters, show_default=False
    ),
]


@app.command("list")
def list_parameters(
    node: OptionalNodeArgument = None,
    *,
    filter_: Annotated[str, typer.Option("--filter", metavar="REGEX", help="Only names that match.")] = "",
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the parameters of one node or of all."""
    from palp_core.graph.discovery.running_graph import Answers

    running = find_graph(graph)
    if node is None:
        answers = running.ask_all("get_parameters", timeout_s=timeout)
    else:
        reply = running.ask(node, "get_parameters", timeout_s=timeout)
        answers = Answers({running.node(node).name: reply}, {})
    try:
        pattern = re.compile(filter_)
    except re.error as error:
        raise GraphError(f"--filter '{filter_}': {error}") from error
    found = {
        f"/{name}": [parameter for parameter in reply["parameters"] if pattern.search(parameter)]
        for name, reply in answers.replies.items()
    }
    if as_json:
        print_json(found)
    else:
        for name, parameters in found.items():
            print_text(f"{name}:")
            for parameter in parameters:
                print_text(f"  {parameter}")
    for silent in answers.silent.values():
        note(str(silent))


@app.command("get")
def get(
    node: NodeArgument,
    name: NameArgument,
    *,
    hide_type: Annotated[bool, typer.Option("--hide-type", help="The value only.")] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print a parameter's value."""
    declared = _describe(node, name, timeout, graph)
    if as_json:
        print_json({"name": name, "value": declared["value"], "type": declared["type"]})
        return
    value = _value_text(declared["value"])
    print_text(value if hide_type else f"{declared['type'].capitalize()} value is: {value}")


@app.command("set", context_settings={"ignore_unknown_options": True})  # -1 is a value
def set_(
    node: NodeArgument,
    name: NameArgument,
    value: Annotated[str, typer.Argument(metavar="VALUE", help="As in YAML.", show_default=False)],
    more: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME VALUE", help="More of them, set together or not at all.", show_default=False
        ),
    ] = None,
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set parameters of a running node, all or none."""
    from palp_core.graph.discovery.message_yaml import parse_yaml
    from palp_core.graph.problems import hint

    words = [name, value, *(more or [])]
    if len(words) % 2:
        raise GraphError(
            f"parameter '{words[-1]}' has no value; write it as in: palp param set NODE NAME VALUE"
        )
    running = find_graph(graph, changes=True)
    declared = running.ask(node, "describe_parameters", timeout_s=timeout)["parameters"]
    wanted: dict[str, Any] = {}
    for parameter, text in zip(words[::2], words[1::2], strict=True):
        if parameter not in declared:
            raise GraphError(
                f"{node} has no parameter '{parameter}'{hint(parameter, declared)}; nothing was set"
            )
        takes_text = declared[parameter]["type"] == "str" and text[:1] not in ("'", '"')
        wanted[parameter] = text if takes_text else parse_yaml(text, f"value of {parameter}")
    _set_and_tell(running, node, wanted, timeout, as_json=as_json)


@app.command("describe")
def describe(
    node: NodeArgument,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME", help="Default: all.", autocompletion=completion.parameters, show_default=False
        ),
    ] = None,
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show type, unit, bounds, default and value."""
    reply = find_graph(graph).ask(node, "describe_parameters", timeout_s=timeout)
    declared = reply["parameters"]
    found = {name: _declared(declared, node, name) for name in names or declared}
    if as_json:
        print_json(found)
        return
    for name, parameter in found.items():
        print_text(f"Parameter name: {name}")
        for what, told in parameter.items():
            if what != "name" and told not in (None, "", [], False):
                print_text(f"  {what.replace('_', ' ').capitalize()}: {_value_text(told)}")
    if about := reply.get("about"):
        print_text(f"\n{about.replace('``', '')}")


@app.command("dump")
def dump(
    node: NodeArgument,
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print a node's parameters as a ROS 2 parameter file."""
    running = find_graph(graph)
    parameters = running.ask(node, "get_parameters", timeout_s=timeout)["parameters"]
    file = {f"/{running.node(node).name}": {"ros__parameters": parameters}}
    if as_json:
        print_json(file)
    else:
        print_text(yaml_text(file).rstrip())


@app.command("load")
def load(
    node: NodeArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="As dump prints it.", show_default=False)],
    *,
    no_use_wildcard: Annotated[
        bool, typer.Option("--no-use-wildcard", help="Refuse the name /**, which stands for every node.")
    ] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set parameters from a ROS 2 parameter file, all or none."""
    from palp_core.graph.description.parameter_file import read_parameter_file

    running = find_graph(graph, changes=True)
    name = running.node(node).name
    before = running.ask(node, "get_parameters", timeout_s=timeout)["parameters"]
    wanted = read_parameter_file(file, name, before, wildcard=not no_use_wildcard)
    changes = {key: value for key, value in wanted.items() if before[key] != value}  # read-only ones may stay
    _set_and_tell(running, node, changes, timeout, as_json=as_json)


def _set_and_tell(
    running: Any, node: str, wanted: dict[str, Any], timeout_s: float, *, as_json: bool
) -> None:
    before = running.ask(node, "get_parameters", timeout_s=timeout_s)["parameters"]
    after = before
    if wanted:
        reply = running.ask(node, "set_parameters", timeout_s=timeout_s, parameters=wanted)
        after = reply["parameters"]
    changed = {name: [before.get(name), value] for name, value in after.items() if before.get(name) != value}
    if as_json:
        print_json({"changed": {name: {"from": old, "to": new} for name, (old, new) in changed.items()}})
        return
    for name, (old, new) in changed.items():
        print_text(f"{name}: {_value_text(old)} -> {_value_text(new)}")
    for name in wanted:
        if name not in changed:
            print_text(f"{name}: is {_value_text(after[name])} already")
    if not wanted:
        print_text("nothing to change")


def _describe(node: str, name: str, timeout_s: float, graph: str | None) -> dict[str, Any]:

    declared = find_graph(graph).ask(node, "describe_parameters", timeout_s=timeout_s)["parameters"]
    return _declared(declared, node, name)


def _declared(declared: dict[str, Any], node: str, name: str) -> dict[str, Any]:
    from palp_core.graph.problems import hint

    if name not in declared:
        raise GraphError(f"{node} has no parameter '{name}'{hint(name, declared)}")
    found: dict[str, Any] = declared[name]
    return found


def _value_text(value: Any) -> str:
    if isinstance(value, str):
        return value if value else "''"
    return yaml_text(value, flow=True).strip()
