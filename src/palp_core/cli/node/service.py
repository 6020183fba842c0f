"""``palp service``: the services of the running graph."""

from typing import Annotated, Any

import typer

from palp_core.cli import options
from palp_core.cli.output import note, print_json, print_names, print_text, yaml_text
from palp_core.cli.running import find_graph
from palp_core.errors import GraphError

app = typer.Typer()


@app.command("list")
def list_services(
    *,
    show_types: Annotated[bool, typer.Option("-t", "--show-types", help="With request and reply.")] = False,
    count: Annotated[bool, typer.Option("-c", "--count-services", help="Their number only.")] = False,
    include_hidden: options.HiddenOption = False,
    timeout: options.TimeoutOption = 5.0,
    graph: options.GraphOption = None,
    as_json: options.JsonOption = False,
) -> None:
    """List the services."""
    running = find_graph(graph)
    answers = running.ask_all("info", timeout_s=timeout)
    services = answers.services(include_hidden=include_hidden)
    if count:
        print_text(str(len(services)))
    elif as_json:
        print_json([{"name": s.name, "node": f"/{s.node}", "types": [s.request, s.reply]} for s in services])
    else:
        for service in services:
            types = f" [{service.request} -> {service.reply}]" if show_types else ""
            print_text(service.name + types)
    for error in answers.silent.values():
        note(str(error))


@app.command("type")
def type_(
    service: options.ServiceArgument,
    *,
    timeout: options.TimeoutOption = 5.0,
    graph: options.GraphOption = None,
    as_json: options.JsonOption = False,
) -> None:
    """Show the types of a service's request and reply."""
    found = find_graph(graph).service(service, timeout)
    if as_json:
        print_json({"service": found.name, "request": found.request, "reply": found.reply})
    else:
        print_text(f"{found.request} -> {found.reply}")


@app.command("find")
def find(
    service_type: Annotated[
        str, typer.Argument(metavar="TYPE", help="Of request or reply.", show_default=False)
    ],
    *,
    timeout: options.TimeoutOption = 5.0,
    graph: options.GraphOption = None,
    as_json: options.JsonOption = False,
) -> None:
    """List the services with a request or reply of a type."""
    from palp_core.graph.problems import hint

    running = find_graph(graph)
    services = running.ask_all("info", timeout_s=timeout).services(include_hidden=True)
    known = {kind for service in services for kind in (service.request, service.reply)}
    if service_type not in known:
        raise GraphError(f"no service takes or gives '{service_type}'{hint(service_type, known)}")
    names = [s.name for s in services if service_type in (s.request, s.reply)]
    print_names(names, count=False, as_json=as_json)


@app.command("call")
def call(
    service: options.ServiceArgument,
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="TYPE {YAML}", help="Type (optional) and request.", show_default=False),
    ] = None,
    *,
    timeout: options.TimeoutOption = 5.0,
    retries: Annotated[
        int, typer.Option(min=0, max=100, help="Ask again so often; the node does it only once.")
    ] = 0,
    graph: options.GraphOption = None,
    as_json: options.JsonOption = False,
) -> None:
    """Call a service and print its reply.

    It waits at most timeout x (1 + retries).
    """
    from palp_core.cli.text.words import type_and_message
    from palp_core.graph.discovery.message_yaml import message_from_yaml
    from palp_core.graph.messages.message_text import readable

    kind, text = type_and_message(words or [], "palp service call /node/port TYPE '{name: value}'")
    with options.until_ctrl_c():
        running = find_graph(graph, changes=True)
        found = running.service(service, timeout)
        if kind is not None and kind not in (found.request, found.request.removesuffix("Request")):
            raise GraphError(f"{found.name} takes {found.request}, not {kind}")
        ports = running.ask(found.node, "schemas", timeout_s=timeout)["ports"]
        request_type, reply_type = ports[found.port]["types"]
        request = message_from_yaml(text or "{}", request_type["json_schema"], "request")
        answer = running.ask(
            found.node, "call", timeout_s=timeout, retries=retries, service=found.port, request=request
        )
    _print_reply(readable(answer["reply"], reply_type["json_schema"]), found.reply, as_json=as_json)


def _print_reply(reply: dict[str, Any], kind: str, *, as_json: bool) -> None:
    if as_json:
        print_json(reply)
        return
    print_text(f"{kind}:")
    for line in yaml_text(reply).splitlines() if reply else ():
        print_text(f"  {line}")
