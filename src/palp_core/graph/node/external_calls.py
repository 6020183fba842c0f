"""What is asked of a node from outside, and again in a replay: changed parameters and calls of a service."""

import base64
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.journal import OUTSIDE, PARAMETERS
from palp_core.graph.node.params import changed_params


def set_parameters(executor: Executor, changes: dict[str, Any]) -> None:
    """Replace a node's parameters as a whole, and publish what has changed.

    Raises:
        GraphError: A change does not fit, is of a read-only parameter, or the node refuses it; nothing is
            changed.
    """
    executor.begin_command()
    node = executor.node
    params = changed_params(executor.declaration, node.params, changes, executor.name)
    wrong = node.examine(params)
    if wrong:  # what was so at the start, or has become so since, is nothing that the change does
        wrong = {name: why for name, why in wrong.items() if node.examine(node.params).get(name) != why}
    if wrong:
        text = "; ".join(f"{name}: {why}" if name else why for name, why in wrong.items())
        raise GraphError(f"{executor.name} refuses the parameters: {text}")
    try:
        node.on_parameters(params)
    except ValueError as error:
        raise GraphError(f"{executor.name} refuses the parameters: {error}") from error
    before, after = msgspec.to_builtins(node.params), msgspec.to_builtins(params)
    node.params = params
    for end in executor.ends.timers.values():
        end.retime(executor.now_ns())
    executor.journal.note_change(PARAMETERS, changes, executor.now_ns())
    changed = {name: [before[name], value] for name, value in after.items() if before[name] != value}
    if changed:
        text = ", ".join(f"{name} = {new}" for name, (_, new) in changed.items())
        executor.events.publish("parameters", text, changed)


def serve_outside(executor: Executor, service: str, request: Message) -> Message:
    """Answer a call from outside the graph; whoever asks sees to it that it is made once.

    Raises:
        NodeError: The handler failed, and the node with it.
    """
    executor.begin_command()
    written = base64.b64encode(encode(request)).decode()
    executor.journal.note_change(f"{OUTSIDE}{service}", {"request": written}, executor.now_ns())
    reply: Message = executor.ends.services[service](request)
    return reply


def read_request(executor: Executor, service: str, written: str) -> Message:
    """Return the request of a recorded call from outside."""
    request: Message = decode(executor.declaration.services[service].request, base64.b64decode(written))
    return request
