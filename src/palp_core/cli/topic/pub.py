"""``palp topic pub``."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

from palp_core.cli import completion
from palp_core.cli.options import Call, argument, graph_verb, option
from palp_core.cli.output import note
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph

RETRY_S = 0.1
MANY_LATE = 10


@graph_verb(timeout_s=5.0, changes=True)
def pub(
    call: Call,
    topic: Annotated[
        str, argument("Port declared external, as in /policy/command.", "TOPIC", complete=completion.topics)
    ],
    given: Annotated[list[str] | None, argument("Type (optional) and message.", "TYPE {YAML}")] = None,
    *,
    stdin: Annotated[bool, option("Messages from standard input, --- between.", "--stdin")] = False,
    rate: Annotated[float, option("Messages per second.", "--rate", "-r", min=0.001, max=10000.0)] = 1.0,
    print_every: Annotated[int, option("Print every Nth message; 0: none.", "--print", "-p", min=0)] = 1,
    once: Annotated[bool, option("One message, then end.", "--once", "-1")] = False,
    times: Annotated[int, option("This many; 0: until Ctrl-C.", "--times", "-t", min=0)] = 0,
    wait_matching: Annotated[
        int | None,
        option("1: until the node is active.", "--wait-matching-subscriptions", "-w", min=0, max=1),
    ] = None,
    max_wait_time_secs: Annotated[
        float | None, option("Longest such wait; default: without end.", min=0.0, metavar="S")
    ] = None,
) -> None:
    """The message is checked before anything is sent; fields that are not given get the type's defaults. The
    node confirms each message with its sequence on the topic. With --stdin the end of the input ends it.
    """
    from palp_core.cli.values import type_and_message

    kind, text = type_and_message(given or [], "palp topic pub /node/port TYPE '{index: 1}'")
    if stdin and text is not None:
        raise GraphError("give the message either as a word or with --stdin, not both")
    running = call.graph
    node, port, described = running.external_port(topic, timeout_s=call.timeout_s)
    schema = described["json_schema"]
    if kind is not None and kind != schema.get("title"):
        raise GraphError(f"{topic} takes {schema.get('title')}, not {kind}")
    messages = _messages(text, schema, stdin=stdin)
    if wait_matching if wait_matching is not None else max_wait_time_secs is not None:
        _await_active(running, node, max_wait_time_secs)
    _publish(call, node, port, messages, rate_hz=rate, limit=1 if once else times, print_every=print_every)


def _messages(text: str | None, schema: dict[str, Any], *, stdin: bool) -> Iterator[dict[str, Any]]:
    """Check what is typed; return the same message for ever, or those of standard input."""
    from palp_core.graph.discovery.message_yaml import message_from_yaml

    if stdin:
        return (message_from_yaml(one, schema, f"message {i}") for i, one in enumerate(_documents(), start=1))
    return itertools.repeat(message_from_yaml(text or "{}", schema, "message"))


def _documents() -> Iterator[str]:
    """Yield the documents of standard input as soon as each is complete."""
    text = ""
    try:
        for line in itertools.chain(sys.stdin, ["---"]):
            if line.startswith(("--- ", "...")):
                raise GraphError(f"'{line.strip()}' between messages: a line of --- alone separates them")
            if line.rstrip() != "---":
                text += line
                continue
            if text.strip():
                yield text
            text = ""
    except UnicodeDecodeError as error:
        raise GraphError(f"standard input is not UTF-8 text: {error}") from error


def _await_active(graph: RunningGraph, node: str, longest_s: float | None) -> None:
    from threading import Event

    from palp_core.graph.clock import monotonic_ns

    end_ns = None if longest_s is None else monotonic_ns() + round(longest_s * 1e9)
    while (state := graph.ask(node, "info")["lifecycle"]) != "active":
        if end_ns is not None and monotonic_ns() > end_ns:
            raise GraphError(f"/{node} is {state} and was not active within {longest_s:g} s")
        Event().wait(RETRY_S)


def _publish(
    call: Call,
    node: str,
    port: str,
    messages: Iterator[dict[str, Any]],
    *,
    rate_hz: float,
    limit: int,
    print_every: int,
) -> None:
    """Send on a grid of absolute times, so that the rate does not drift."""
    from threading import Event

    from palp_core.graph.clock import monotonic_ns

    start_ns, late = monotonic_ns(), 0
    for index, message in enumerate(messages):
        wait_s = (start_ns + round(index * 1e9 / rate_hz) - monotonic_ns()) / 1e9
        late += wait_s < -1.0 / rate_hz
        if wait_s > 0:
            Event().wait(wait_s)
        reply = call.graph.ask(node, "publish", timeout_s=call.timeout_s, port=port, message=message)
        sequence = reply["sequence"]
        is_due = print_every and (index + 1) % print_every == 0
        lines = [f"publishing #{index + 1}: sequence {sequence}"] if is_due else []
        call.show({"topic": f"/{node}/{port}", "sequence": sequence}, lines)
        sys.stdout.flush()
        if index + 1 == limit:
            break
    if late > MANY_LATE:
        note(f"{late} messages were more than a period late: {rate_hz:g} Hz is too fast for one at a time")
