"""``palp param``: the parameters of running nodes, in ROS 2's words and file form."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.options import Call, NodeArgument, OptionalNodeArgument, argument, graph_verb, option
from palp_core.cli.output import yaml_text
from palp_core.errors import GraphError

app = typer.Typer()

NameArgument = Annotated[str, argument("Of the parameter.", "NAME", complete=completion.parameters)]


@app.command("list")
@graph_verb(timeout_s=5.0)
def list_parameters(
    call: Call,
    node: OptionalNodeArgument = None,
    *,
    filter_: Annotated[str, option("Only names that match.", "--filter", metavar="REGEX")] = "",
) -> None:
    """List the parameters of one node or of all."""
    from palp_core.graph.discovery.running_graph import Answers

    running = call.graph
    if node is None:
        answers = running.ask_all("get_parameters", timeout_s=call.timeout_s)
    else:
        reply = running.ask(node, "get_parameters", timeout_s=call.timeout_s)
        answers = Answers({running.node(node).name: reply}, {})
    try:
        pattern = re.compile(filter_)
    except re.error as error:
        raise GraphError(f"--filter '{filter_}': {error}") from error
    found = {
        f"/{name}": [parameter for parameter in reply["parameters"] if pattern.search(parameter)]
        for name, reply in answers.replies.items()
    }
    call.show(found, ("\n  ".join((f"{name}:", *parameters)) for name, parameters in found.items()))
    call.note_silent(answers.silent)


@app.command("get")
@graph_verb(timeout_s=5.0)
def get(
    call: Call,
    node: NodeArgument,
    name: NameArgument,
    *,
    hide_type: Annotated[bool, option("The value only.", "--hide-type")] = False,
) -> None:
    """Print a parameter's value."""
    reply = call.graph.ask(node, "describe_parameters", timeout_s=call.timeout_s)
    declared = _declared(reply["parameters"], node, name)
    text = _value_text(declared["value"])
    call.show(
        {"name": name, "value": declared["value"], "type": declared["type"]},
        [text if hide_type else f"{declared['type'].capitalize()} value is: {text}"],
    )


@app.command("set", context_settings={"ignore_unknown_options": True})  # -1 is a value
@graph_verb(timeout_s=5.0, changes=True)
def set_(
    call: Call,
    node: NodeArgument,
    name: NameArgument,
    value: Annotated[str, argument("As in YAML.", "VALUE")],
    more: Annotated[
        list[str] | None, argument("More of them, set together or not at all.", "NAME VALUE")
    ] = None,
) -> None:
    """Set parameters of a running node, all or none."""
    given = [name, value, *(more or [])]
    if len(given) % 2:
        raise GraphError(
            f"parameter '{given[-1]}' has no value; write it as in: palp param set NODE NAME VALUE"
        )
    texts = dict(zip(given[::2], given[1::2], strict=True))
    _set(call, node, call.graph.typed_parameters(node, texts, timeout_s=call.timeout_s))


@app.command("describe")
@graph_verb(timeout_s=5.0)
def describe(
    call: Call,
    node: NodeArgument,
    names: Annotated[
        list[str] | None, argument("Default: all.", "NAME", complete=completion.parameters)
    ] = None,
) -> None:
    """Show type, unit, bounds, default and value."""
    reply = call.graph.ask(node, "describe_parameters", timeout_s=call.timeout_s)
    declared = reply["parameters"]
    found = {name: _declared(declared, node, name) for name in names or declared}
    lines = []
    for name, parameter in found.items():
        lines.append(f"Parameter name: {name}")
        for what, value in parameter.items():
            if what != "name" and value not in (None, "", [], False):
                lines.append(f"  {what.replace('_', ' ').capitalize()}: {_value_text(value)}")
    if about := reply.get("about"):
        lines.append(f"\n{about.replace('``', '')}")
    call.show(found, lines)


@app.command("dump")
@graph_verb(timeout_s=5.0)
def dump(call: Call, node: NodeArgument) -> None:
    """Print a node's parameters as a ROS 2 parameter file."""
    running = call.graph
    parameters = running.ask(node, "get_parameters", timeout_s=call.timeout_s)["parameters"]
    file = {f"/{running.node(node).name}": {"ros__parameters": parameters}}
    call.show(file, [yaml_text(file).rstrip()])


@app.command("load")
@graph_verb(timeout_s=5.0, changes=True)
def load(
    call: Call,
    node: NodeArgument,
    file: Annotated[Path, argument("As dump prints it.", "FILE")],
    *,
    no_use_wildcard: Annotated[
        bool, option("Refuse the name /**, which means every node.", "--no-use-wildcard")
    ] = False,
) -> None:
    """Set parameters from a ROS 2 parameter file, all or none."""
    from palp_core.graph.description.parameter_file import read_parameter_file

    running = call.graph
    name = running.node(node).name
    before = running.ask(node, "get_parameters", timeout_s=call.timeout_s)["parameters"]
    wanted = read_parameter_file(file, name, before, wildcard=not no_use_wildcard)
    changes = {key: value for key, value in wanted.items() if before[key] != value}  # read-only ones may stay
    _set(call, node, changes)


def _set(call: Call, node: str, wanted: dict[str, Any]) -> None:
    before = call.graph.ask(node, "get_parameters", timeout_s=call.timeout_s)["parameters"]
    after = before
    if wanted:
        reply = call.graph.ask(node, "set_parameters", timeout_s=call.timeout_s, parameters=wanted)
        after = reply["parameters"]
    changed = {name: (before.get(name), new) for name, new in after.items() if before.get(name) != new}
    lines = [f"{name}: {_value_text(old)} -> {_value_text(new)}" for name, (old, new) in changed.items()]
    lines += [f"{name}: is {_value_text(after[name])} already" for name in wanted if name not in changed]
    changes = {name: {"from": old, "to": new} for name, (old, new) in changed.items()}
    call.show({"changed": changes}, lines or ["nothing to change"])


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
