"""``palp topic list``, ``info``, ``type`` and ``find``."""

from typing import Annotated, Any

import typer

from palp_core.cli.options import GraphOption, HiddenOption, JsonOption, TimeoutOption, TopicArgument
from palp_core.cli.output import note, print_json, print_names, print_text
from palp_core.cli.running import find_graph
from palp_core.cli.text.words import type_name
from palp_core.errors import GraphError


def list_topics(
    *,
    show_types: Annotated[bool, typer.Option("-t", "--show-types", help="With message types.")] = False,
    count: Annotated[bool, typer.Option("-c", "--count-topics", help="Their number only.")] = False,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="With publishers.")] = False,
    include_hidden: HiddenOption = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    topics = find_graph(graph).topics(include_hidden=include_hidden)
    if count:
        print_text(str(len(topics)))
    elif as_json:
        print_json([{"name": t.name, "type": t.type, "hash": t.type_hash, "node": t.node} for t in topics])
    else:
        for topic in topics:
            kind = f" [{topic.type}]" if show_types or verbose else ""
            print_text(topic.name + kind + (f" published by /{topic.node}" if verbose else ""))


def info(
    topic: TopicArgument,
    *,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="With quality of service.")] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    from palp_core.graph.node.spec import LAUNCHER

    running = find_graph(graph)
    entry = running.topic(topic)
    asked = [*running.node_names, *([LAUNCHER] if entry.node == LAUNCHER else [])]
    answers = running.ask_all("info", asked, timeout_s=timeout)
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
    if as_json:
        found = {"topic": entry.name, "type": entry.type, "hash": entry.type_hash}
        print_json(found | {"publisher": publisher, "readers": readers, "unresponsive": silent})
        return
    print_text(f"Type: {entry.type}")
    print_text("Publisher count: 1")
    _print_end(publisher, verbose=verbose)
    print_text(f"Subscription count: {len(readers)}")
    for reader in readers:
        _print_end(reader, verbose=verbose)
    if verbose:
        print_text(f"Type hash: {entry.type_hash}")
    for error in answers.silent.values():
        note(str(error))


def _print_end(end: dict[str, Any], *, verbose: bool) -> None:
    counts = [f"{end[name]} {name}" for name in ("received", "lost", "late", "dropped") if name in end]
    if end.get("sequence") is not None and not counts:
        counts = [f"{end['sequence']} published"]
    port = f" port '{end['port']}'" if end.get("port") else ""
    print_text(f"  {end['node']}{port}" + (f": {', '.join(counts)}" if counts else ""))
    if verbose:
        for name, value in end.get("qos", {}).items():
            print_text(f"    {name}: {value}")


def type_(topic: TopicArgument, *, graph: GraphOption = None, as_json: JsonOption = False) -> None:
    entry = find_graph(graph).topic(topic)
    if as_json:
        print_json({"topic": entry.name, "type": entry.type, "hash": entry.type_hash})
    else:
        print_text(entry.type)


def find(
    message_type: Annotated[str, typer.Argument(metavar="TYPE", help="As in Belief.", show_default=False)],
    *,
    count: Annotated[bool, typer.Option("-c", "--count-topics", help="Their number only.")] = False,
    include_hidden: HiddenOption = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    from palp_core.graph.problems import hint

    running = find_graph(graph)
    topics = running.topics(include_hidden=True)
    wanted = type_name(message_type)
    known = {topic.type for topic in topics}
    if wanted not in known:
        raise GraphError(f"no topic carries '{message_type}'{hint(wanted, known)}")
    shown = {topic.name for topic in running.topics(include_hidden=include_hidden)}
    names = [topic.name for topic in topics if topic.type == wanted and topic.name in shown]
    print_names(names, count=count, as_json=as_json)
