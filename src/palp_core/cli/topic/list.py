"""``palp topic list``, ``info``, ``type`` and ``find``."""

from collections.abc import Iterator
from typing import Annotated, Any

from palp_core.cli.options import Call, HiddenOption, TopicArgument, argument, graph_verb, option
from palp_core.cli.values import type_name


@graph_verb()
def list_topics(
    call: Call,
    *,
    show_types: Annotated[bool, option("With message types.", "-t", "--show-types")] = False,
    count: Annotated[bool, option("Their number only.", "-c", "--count-topics")] = False,
    verbose: Annotated[bool, option("With publishers.", "-v", "--verbose")] = False,
    include_hidden: HiddenOption = False,
) -> None:
    topics = call.graph.topics(include_hidden=include_hidden)
    kind = " [{0.type}]" if show_types or verbose else ""
    line = "{0.name}" + kind + (" published by /{0.node}" if verbose else "")
    call.show(
        [{"name": t.name, "type": t.type, "hash": t.type_hash, "node": t.node} for t in topics],
        map(line.format, topics),
        count=count,
    )


@graph_verb(timeout_s=5.0)
def info(
    call: Call,
    topic: TopicArgument,
    *,
    verbose: Annotated[bool, option("With quality of service.", "-v", "--verbose")] = False,
) -> None:
    from palp_core.graph.node.spec import LAUNCHER

    running = call.graph
    entry = running.topic(topic)
    asked = [*running.node_names, *([LAUNCHER] if entry.node == LAUNCHER else [])]
    answers = running.ask_all("info", asked, timeout_s=call.timeout_s)
    output = answers.replies.get(entry.node, {}).get("outputs", {}).get(entry.name, {})
    readers = [
        {"node": f"/{edge.node}", **{k: v for k, v in edge.account.items() if k != "topic"}}
        for edge in answers.edges(entry.name)
    ]
    publisher: dict[str, Any] = {
        "node": f"/{entry.node}",
        "sequence": answers.replies.get(entry.node, {}).get("published", {}).get(entry.name),
        "qos": output.get("qos", {}),
    }
    silent = sorted(f"/{name}" for name in answers.silent)
    found = {"topic": entry.name, "type": entry.type, "hash": entry.type_hash}
    call.show(
        found | {"publisher": publisher, "readers": readers, "unresponsive": silent},
        [
            f"Type: {entry.type}",
            "Publisher count: 1",
            *_end_lines(publisher, verbose=verbose),
            f"Subscription count: {len(readers)}",
            *(line for reader in readers for line in _end_lines(reader, verbose=verbose)),
            *([f"Type hash: {entry.type_hash}"] if verbose else []),
        ],
    )
    if not call.as_json:
        call.note_silent(answers.silent)


def _end_lines(end: dict[str, Any], *, verbose: bool) -> Iterator[str]:
    counts = [f"{end[name]} {name}" for name in ("received", "lost", "late", "dropped") if name in end]
    if end.get("sequence") is not None and not counts:
        counts = [f"{end['sequence']} published"]
    port = f" port '{end['port']}'" if end.get("port") else ""
    yield f"  {end['node']}{port}" + (f": {', '.join(counts)}" if counts else "")
    if verbose:
        yield from (f"    {name}: {value}" for name, value in end.get("qos", {}).items())


@graph_verb()
def type_(call: Call, topic: TopicArgument) -> None:
    entry = call.graph.topic(topic)
    call.show({"topic": entry.name, "type": entry.type, "hash": entry.type_hash}, [entry.type])


@graph_verb()
def find(
    call: Call,
    message_type: Annotated[str, argument("As in Belief.", "TYPE")],
    *,
    count: Annotated[bool, option("Their number only.", "-c", "--count-topics")] = False,
    include_hidden: HiddenOption = False,
) -> None:
    shown = {topic.name for topic in call.graph.topics(include_hidden=include_hidden)}
    types = {topic.name: [topic.type] for topic in call.graph.topics(include_hidden=True)}
    call.show_of_type(type_name(message_type), types, "topic carries", shown, count=count)
