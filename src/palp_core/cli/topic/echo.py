"""``palp topic echo``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from palp_core.cli.options import Call, TopicArgument, argument, graph_verb, option
from palp_core.cli.output import note, print_json, print_text, yaml_text
from palp_core.cli.running import note_ended, published_text
from palp_core.cli.values import type_name
from palp_core.counted import counted
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
    from palp_core.graph.messages.frame import Frame
    from palp_core.graph.messages.topic import Topic

SILENCE_NS = 3_000_000_000


@graph_verb()
def echo(
    call: Call,
    topic: TopicArgument,
    message_type: Annotated[
        str | None, argument("Expected message type; an error if it differs.", "TYPE")
    ] = None,
    *,
    field: Annotated[str | None, option("One field only, as in posterior[0].", metavar="A.B")] = None,
    as_csv: Annotated[bool, option("A line of comma-separated values each.", "--csv")] = False,
    full_length: Annotated[bool, option("Leave nothing out.", "--full-length", "-f")] = False,
    truncate_length: Annotated[
        int, option("Elements and characters to show.", "--truncate-length", "-l", min=0)
    ] = 128,
    no_arr: Annotated[bool, option("Lengths instead of arrays.", "--no-arr")] = False,
    no_str: Annotated[bool, option("Lengths instead of texts.", "--no-str")] = False,
    once: Annotated[bool, option("One message, then end.", "--once")] = False,
    times: Annotated[int, option("This many; 0: without end.", "--times", "-n", min=0)] = 0,
    timeout: Annotated[
        float | None, option("End with status 2 after this silence.", metavar="S", min=0.0)
    ] = None,
    include_message_info: Annotated[
        bool, option("Sequence, epoch and stamp, too.", "--include-message-info", "-i")
    ] = False,
    no_lost_messages: Annotated[bool, option("Do not report lost messages.", "--no-lost-messages")] = False,
    qos_reliability: Annotated[
        Literal["best_effort", "reliable"] | None, option("Default: best_effort.")
    ] = None,
    qos_durability: Annotated[
        Literal["volatile", "transient_local"] | None, option("Default: volatile, nothing from before.")
    ] = None,
    qos_depth: Annotated[int | None, option("Number of earlier messages to show first.", min=1)] = None,
) -> None:
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.message_text import Truncation, decoded, parse_path, pick

    running = call.graph
    entry = running.topic(topic)
    if message_type is not None and type_name(message_type) != entry.type:
        raise GraphError(f"{entry.name} carries {entry.type}, not {message_type}")
    path = None if field is None else parse_path(field, entry.json_schema)
    depth, reliable = requested_depth(running, entry, qos_reliability, qos_durability, qos_depth)
    how = Truncation(None if full_length else truncate_length, not no_arr, not no_str)
    show = _printer(how, as_json=call.as_json, as_csv=as_csv)
    limit = 1 if once else times
    shown = 0
    with TopicReader(running, [entry], history_depth=depth, reliable=reliable) as listener:
        for received in _until_silent(listener, entry, timeout):
            if received.lost and not no_lost_messages:
                before = f"message {received.frame.sequence}" if received.is_message else "now"
                note(f"{entry.name}: {counted(received.lost, 'message')} lost before {before}")
            if not received.is_message:
                continue
            message = decoded(received.frame.payload, entry.json_schema)
            info = _info(received.frame) if include_message_info else None
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
    graph: RunningGraph, entry: Topic, reliability: str | None, durability: str | None, depth: int | None
) -> tuple[int, bool]:
    """Return how many messages from before come first, and whether gaps are asked for."""
    import msgspec

    from palp_core.graph.messages.qos import Qos, incompatibility
    from palp_core.graph.node.spec import LAUNCHER

    stated = {"reliability": reliability, "durability": durability, "depth": depth}
    wanted = {name: value for name, value in stated.items() if value is not None}
    if not wanted:
        return 0, False
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
    """Yield what comes; note when nothing has come for a while."""
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
            known = published_text(listener, entry.name)
            note(f"{entry.name}: no message for {SILENCE_NS // 10**9} s ({known}); waiting")


def _info(frame: Frame) -> dict[str, Any]:
    names = ("topic", "epoch", "sequence", "stamp_ns")
    return {name: getattr(frame, name) for name in names} | {"type_hash": f"{frame.type_hash:016x}"}


def _printer(how: Any, *, as_json: bool, as_csv: bool) -> Callable[[Any, dict[str, Any] | None], None]:
    """Return the function that prints one message in the form that was asked for."""
    from palp_core.graph.messages.message_text import csv_line, truncated

    def show(message: Any, info: dict[str, Any] | None) -> None:
        whole = message if info is None else {"info": info, "message": message}
        if as_json:
            print_json(whole)
        elif as_csv:
            print_text(csv_line(whole))
        else:
            for part in (*([] if info is None else [info]), truncated(message, how)):
                print_text(yaml_text(part) + "---")

    return show
