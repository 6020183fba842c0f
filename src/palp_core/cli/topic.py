"""``palp topic``: the topics of the running graph."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.launch import print_text
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.launch.run_directory import RunRecord, TopicEntry

__all__ = ["app"]

app = typer.Typer(help="Topics of the running graph.", no_args_is_help=True)
GraphOption = Annotated[str | None, typer.Option(help="Name of the graph; default: the latest.")]
JsonOption = Annotated[bool, typer.Option("--json", help="For machines.")]
TimeoutOption = Annotated[float, typer.Option(help="Seconds to wait for a message.")]


@app.command("list")
def list_topics(
    *,
    show_types: Annotated[bool, typer.Option("-t", "--show-types", help="With message types.")] = False,
    count: Annotated[bool, typer.Option("-c", "--count-topics", help="Their number only.")] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the topics."""
    from palp_core.launch.run_directory import find_running

    topics = find_running(graph).topics
    if count:
        print_text(str(len(topics)))
    elif as_json:
        print_text(json.dumps([{"name": t.name, "type": t.type, "hash": t.type_hash} for t in topics]))
    else:
        for topic in topics:
            print_text(f"{topic.name} [{topic.type}]" if show_types else topic.name)


@app.command("echo")
def echo(
    topic: Annotated[str, typer.Argument(help="As in /estimator/belief.")],
    *,
    once: Annotated[bool, typer.Option("--once", help="One message, then end.")] = False,
    times: Annotated[int, typer.Option("--times", "-n", help="This many messages; 0: without end.")] = 0,
    field: Annotated[str | None, typer.Option(help="One field only, as in posterior.")] = None,
    no_arr: Annotated[bool, typer.Option("--no-arr", help="Lengths instead of arrays.")] = False,
    truncate_length: Annotated[
        int, typer.Option("--truncate-length", "-l", help="Elements of an array to show.")
    ] = 128,
    full_length: Annotated[bool, typer.Option("--full-length", "-f", help="All elements.")] = False,
    timeout: TimeoutOption = 10.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print messages as they are published."""
    import msgspec
    import yaml

    _, entry = _find(topic, graph)
    limit = 1 if once else times
    for shown, frame in enumerate(_frames(entry, timeout), start=1):
        message = _readable(msgspec.msgpack.decode(frame.payload), entry.json_schema)
        if field is not None:
            if field not in message:
                raise GraphError(f"{topic} has no field '{field}'; it has: {', '.join(message)}")
            message = {field: message[field]}
        if not as_json:
            message = {
                name: _shortened(value, 0 if no_arr else truncate_length, full_length)
                for name, value in message.items()
            }
        print_text(
            json.dumps(message)
            if as_json
            else yaml.safe_dump(message, sort_keys=False, default_flow_style=None) + "---"
        )
        if shown == limit:
            return


@app.command("hz")
def hz(
    topic: Annotated[str, typer.Argument(help="As in /torque/block.")],
    *,
    window: Annotated[int, typer.Option("--window", "-w", help="Messages to measure.")] = 100,
    timeout: TimeoutOption = 10.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure a topic's rate from its messages' own sequence numbers and stamps."""
    from palp_core.runtime.clock import monotonic_ns

    record, entry = _find(topic, graph)
    first = last = None
    begin_ns = end_ns = lost = 0
    for received, frame in enumerate(_frames(entry, timeout)):
        end_ns = monotonic_ns()
        if first is None or frame.epoch != first.epoch:  # a restarted publisher counts from 1 again
            first, begin_ns, lost = frame, end_ns, 0
        elif last is not None:
            lost += frame.sequence - last.sequence - 1
        last = frame
        if received >= window:
            break
    if first is None or last is None or first is last:
        raise GraphError(f"{topic}: fewer than two messages within {timeout:g} s")
    count = last.sequence - first.sequence
    span_s, wall_s = (last.stamp_ns - first.stamp_ns) / 1e9, (end_ns - begin_ns) / 1e9
    result = {
        "topic": topic,
        "clock": record.clock,
        "hz": count / span_s if span_s else None,
        "wall_hz": count / wall_s if wall_s else None,
        "messages": count + 1,
        "lost": lost,
    }
    if as_json:
        print_text(json.dumps(result))
        return
    rate = f"{result['hz']:.3f} Hz" if result["hz"] else "no rate: all at one instant"
    wall = f", {result['wall_hz']:.1f} Hz of wall time" if record.clock == "sim" and result["wall_hz"] else ""
    print_text(f"{topic}: {rate}{wall} over {count + 1} messages, {lost} lost")


def _find(name: str, graph: str | None) -> tuple[RunRecord, TopicEntry]:
    from palp_core.launch.problems import hint
    from palp_core.launch.run_directory import find_running

    record = find_running(graph)
    for entry in record.topics:
        if entry.name == name:
            return record, entry
    raise GraphError(
        f"no topic '{name}' in graph '{record.graph}'{hint(name, [t.name for t in record.topics])}"
    )


def _frames(entry: TopicEntry, timeout_s: float) -> Any:
    """Yield data frames as they come; end when none comes for a while."""
    from palp_core.runtime.clock import monotonic_ns
    from palp_core.runtime.wire import Kind, parse
    from palp_core.runtime.zmq_bus import Subscriber

    subscriber = Subscriber({entry.name: entry.publish})
    try:
        deadline_ns = monotonic_ns() + round(timeout_s * 1e9)
        while monotonic_ns() < deadline_ns:
            subscriber.wait(0.1)
            for raw in subscriber.receive():
                frame = parse(raw)
                if frame.kind == Kind.DATA:
                    yield frame
                    deadline_ns = monotonic_ns() + round(timeout_s * 1e9)
        raise GraphError(f"{entry.name}: no message for {timeout_s:g} s")
    finally:
        subscriber.close()


def _readable(message: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Turn binary arrays into lists, by the schema."""
    import numpy as np

    readable: dict[str, Any] = {}
    for name, value in message.items():
        known = schema["properties"].get(name, {})
        if isinstance(value, bytes) and known.get("x-dtype") == "<f8":
            readable[name] = np.frombuffer(value, dtype="<f8").tolist()
        elif isinstance(value, bytes):
            readable[name] = value.hex()
        elif isinstance(value, dict):
            readable[name] = _readable(value, known)
        else:
            readable[name] = value
    return readable


def _shortened(value: Any, length: int, full: bool) -> Any:
    if not isinstance(value, list) or full or len(value) <= length:
        return value
    if length == 0:
        return f"<array of {len(value)}>"
    return [*value[:length], f"... {len(value) - length} more"]
