"""``palp topic echo``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from palp_core.cli.options import Call, TopicArgument, graph_verb
from palp_core.cli.output import note, print_json, print_text, yaml_text
from palp_core.cli.running import note_ended
from palp_core.cli.text.words import type_name
from palp_core.counted import counted
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
    from palp_core.graph.messages.topic import Topic

Profile = Literal["default", "sensor_data", "latched"]
SILENCE_NS = 3_000_000_000


@graph_verb()
def echo(
    call: Call,
    topic: TopicArgument,
    message_type: Annotated[
        str | None, typer.Argument(metavar="TYPE", help="Of the messages, to be sure.", show_default=False)
    ] = None,
    *,
    field: Annotated[
        str | None, typer.Option(metavar="A.B", help="One field only, as in posterior[0].")
    ] = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="A line of comma-separated values each.")] = False,
    flow_style: Annotated[bool, typer.Option("--flow-style", help="A line of YAML each.")] = False,
    full_length: Annotated[bool, typer.Option("--full-length", "-f", help="Leave nothing out.")] = False,
    truncate_length: Annotated[
        int, typer.Option("--truncate-length", "-l", min=0, help="Elements and characters to show.")
    ] = 128,
    no_arr: Annotated[bool, typer.Option("--no-arr", help="Lengths instead of arrays.")] = False,
    no_str: Annotated[bool, typer.Option("--no-str", help="Lengths instead of texts.")] = False,
    raw: Annotated[bool, typer.Option("--raw", help="The bytes as they travel.")] = False,
    once: Annotated[bool, typer.Option("--once", help="One message, then end.")] = False,
    times: Annotated[int, typer.Option("--times", "-n", min=0, help="This many; 0: without end.")] = 0,
    timeout: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="End with status 2 after this silence.")
    ] = None,
    include_message_info: Annotated[
        bool, typer.Option("--include-message-info", "-i", help="Sequence, epoch and stamp, too.")
    ] = False,
    no_lost_messages: Annotated[
        bool, typer.Option("--no-lost-messages", help="Do not say how many were lost.")
    ] = False,
    clear: Annotated[bool, typer.Option("--clear", "-c", help="Clear the terminal before each.")] = False,
    qos_profile: Annotated[Profile | None, typer.Option(help="Default: what the publisher offers.")] = None,
    qos_reliability: Annotated[Literal["best_effort", "reliable"] | None, typer.Option()] = None,
    qos_durability: Annotated[Literal["volatile", "transient_local"] | None, typer.Option()] = None,
    qos_depth: Annotated[
        int | None, typer.Option(min=1, help="Messages from before that come first.")
    ] = None,
) -> None:
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.message_text import Truncation, decoded, parse_path, pick

    running = call.graph
    entry = running.topic(topic)
    _same_type(entry, message_type)
    path = None if field is None else parse_path(field, entry.json_schema)
    depth, reliable = requested_depth(running, entry, qos_profile, qos_reliability, qos_durability, qos_depth)
    how = Truncation(None if full_length else truncate_length, not no_arr, not no_str)
    show = _printer(how, as_json=call.as_json, as_csv=as_csv, flow_style=flow_style)
    limit = 1 if once else times
    shown = 0
    with TopicReader(running, [entry], history_depth=depth, reliable=reliable) as listener:
        for received in _until_silent(listener, entry, timeout):
            if received.lost and not no_lost_messages:
                note(f"{entry.name}: {counted(received.lost, 'message')} lost before {_ordinal(received)}")
            if not received.is_message:
                continue
            message = decoded(received.frame.payload, entry.json_schema)
            if clear:
                sys.stdout.write("\033[2J\033[H")
            info = _info(received) if include_message_info else None
            if raw:
                _print_raw(received, info)
            else:
                show(message if path is None else pick(message, path), info)
            sys.stdout.flush()
            shown += 1
            if shown == limit:
                return
        if shown == 0 or limit:
            raise GraphError(
                f"graph '{running.record.graph}' ended after {counted(shown, 'message')} of {entry.name}"
            )
        note_ended(running)


def requested_depth(
    graph: RunningGraph,
    entry: Topic,
    profile: str | None,
    reliability: str | None,
    durability: str | None,
    depth: int | None,
) -> tuple[int, bool]:
    """Return how many messages from before come first, and whether gaps are asked for.

    Raises:
        GraphError: The publisher offers less than what is requested.
    """
    import msgspec

    from palp_core.graph.messages.qos import Qos, incompatibility
    from palp_core.graph.node.spec import LAUNCHER

    if (profile, reliability, durability, depth) == (None, None, None, None):
        return 0, False
    wanted = {
        "sensor_data": {"reliability": "best_effort", "depth": 5},
        "latched": {"durability": "transient_local", "depth": 1},
    }.get(profile or "default", {})
    stated = {"reliability": reliability, "durability": durability, "depth": depth}
    wanted |= {name: value for name, value in stated.items() if value is not None}
    if entry.node == LAUNCHER:
        offered = Qos(durability="transient_local", depth=100)
    else:
        offered = msgspec.convert(graph.ask(entry.node, "info")["outputs"][entry.name]["qos"], Qos)
    wanted.setdefault("depth", offered.depth)
    requested = msgspec.convert(wanted, Qos)
    reason = incompatibility(requested, offered)
    if reason is not None:
        raise GraphError(f"{entry.name}: {reason}; ask for less")
    latched = requested.durability == "transient_local"
    return min(requested.depth, offered.depth) if latched else 0, requested.reliability == "reliable"


def _until_silent(listener: TopicReader, entry: Topic, timeout_s: float | None) -> Iterator[ReceivedFrame]:
    """Yield what comes; note when nothing has come for a while.

    Raises:
        GraphError: Nothing has come for as long as the caller would wait.
    """
    from palp_core.graph.clock import monotonic_ns

    last_ns, is_noted = monotonic_ns(), False
    for received in listener.messages():
        if received is not None:
            last_ns, is_noted = monotonic_ns(), False
            yield received
            last_ns = monotonic_ns()
            continue
        silent_ns = monotonic_ns() - last_ns
        if timeout_s is not None and silent_ns > timeout_s * 1e9:
            raise GraphError(f"{entry.name}: no message for {timeout_s:g} s")
        if silent_ns > SILENCE_NS and not is_noted:
            is_noted = True
            count = listener.last_sequence.get(entry.name)
            known = "its publisher does not answer" if count is None else f"{count} published so far"
            note(f"{entry.name}: nothing for {SILENCE_NS // 10**9} s ({known}); waiting")


def _same_type(entry: Topic, stated: str | None) -> None:
    if stated is not None and type_name(stated) != entry.type:
        raise GraphError(f"{entry.name} carries {entry.type}, not {stated}")


def _info(received: ReceivedFrame) -> dict[str, Any]:
    frame = received.frame
    return {
        "topic": frame.topic,
        "epoch": frame.epoch,
        "sequence": frame.sequence,
        "stamp_ns": frame.stamp_ns,
        "type_hash": f"{frame.type_hash:016x}",
    }


def _ordinal(received: ReceivedFrame) -> str:
    return f"message {received.frame.sequence}" if received.is_message else "now"


def _print_raw(received: ReceivedFrame, info: dict[str, Any] | None) -> None:
    if info is not None:
        print_json(info)
    print_text(repr(bytes(received.frame.payload)))


def _printer(
    how: Any, *, as_json: bool, as_csv: bool, flow_style: bool
) -> Callable[[Any, dict[str, Any] | None], None]:
    """Return the function that prints one message in the form that was asked for."""
    from palp_core.graph.messages.message_text import csv_line, truncated

    def show(message: Any, info: dict[str, Any] | None) -> None:
        if as_json:
            print_json(message if info is None else {"info": info, "message": message})
            return
        if as_csv:
            print_text(csv_line(message if info is None else {"info": info, "message": message}))
            return
        parts = [truncated(message, how)] if info is None else [info, truncated(message, how)]
        for part in parts:
            print_text(yaml_text(part, flow=flow_style) + "---")

    return show
