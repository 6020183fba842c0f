"""``palp service``: the services of the running graph."""

from typing import Annotated

import typer

from palp_core.cli.options import Call, HiddenOption, ServiceArgument, argument, graph_verb, option
from palp_core.cli.output import yaml_text
from palp_core.errors import GraphError

app = typer.Typer()


@app.command("list")
@graph_verb(timeout_s=5.0)
def list_services(
    call: Call,
    *,
    show_types: Annotated[bool, option("With request and reply.", "-t", "--show-types")] = False,
    count: Annotated[bool, option("Their number only.", "-c", "--count-services")] = False,
    include_hidden: HiddenOption = False,
) -> None:
    """List the services."""
    running = call.graph
    answers = running.ask_all("info", timeout_s=call.timeout_s)
    services = answers.services(include_hidden=include_hidden)
    call.show(
        [{"name": s.name, "node": f"/{s.node}", "types": [s.request, s.reply]} for s in services],
        (s.name + (f" [{s.request} -> {s.reply}]" if show_types else "") for s in services),
        count=count,
    )
    call.note_silent(answers.silent)


@app.command("type")
@graph_verb(timeout_s=5.0)
def type_(call: Call, service: ServiceArgument) -> None:
    """Show the types of a service's request and reply."""
    found = call.graph.service(service, call.timeout_s)
    types = {"service": found.name, "request": found.request, "reply": found.reply}
    call.show(types, [f"{found.request} -> {found.reply}"])


@app.command("find")
@graph_verb(timeout_s=5.0)
def find(call: Call, service_type: Annotated[str, argument("Of request or reply.", "TYPE")]) -> None:
    """List the services with a request or reply of a type."""
    services = call.graph.ask_all("info", timeout_s=call.timeout_s).services(include_hidden=True)
    types = {service.name: (service.request, service.reply) for service in services}
    call.show_of_type(service_type, types, "service takes or gives")


@app.command("call")
@graph_verb(timeout_s=5.0, changes=True)
def call_service(
    call: Call,
    service: ServiceArgument,
    given: Annotated[list[str] | None, argument("Type (optional) and request.", "TYPE {YAML}")] = None,
    *,
    retries: Annotated[int, option("Ask again so often; the node does it only once.", min=0, max=100)] = 0,
) -> None:
    """Call a service and print its reply.

    It waits at most timeout x (1 + retries).
    """
    from palp_core.cli.values import type_and_message
    from palp_core.graph.discovery.message_yaml import message_from_yaml
    from palp_core.graph.messages.message_text import readable

    kind, text = type_and_message(given or [], "palp service call /node/port TYPE '{name: value}'")
    running = call.graph
    found = running.service(service, call.timeout_s)
    if kind is not None and kind not in (found.request, found.request.removesuffix("Request")):
        raise GraphError(f"{found.name} takes {found.request}, not {kind}")
    ports = running.ask(found.node, "schemas", timeout_s=call.timeout_s)["ports"]
    request_type, reply_type = ports[found.port]["types"]
    request = message_from_yaml(text or "{}", request_type["json_schema"], "request")
    answer = running.ask(
        found.node, "call", timeout_s=call.timeout_s, retries=retries, service=found.port, request=request
    )
    reply = readable(answer["reply"], reply_type["json_schema"])
    lines = yaml_text(reply).splitlines() if reply else []
    call.show(reply, [f"{found.reply}:", *(f"  {line}" for line in lines)])
