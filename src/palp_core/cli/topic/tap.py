"""``palp tap``."""

from typing import Annotated

import typer

from palp_core.cli import completion
from palp_core.cli.options import ExcludeRegexOption, GraphOption, RegexOption, until_ctrl_c
from palp_core.cli.output import note
from palp_core.cli.running import find_graph
from palp_core.counted import counted


def tap(
    topics: Annotated[
        list[str] | None,
        typer.Argument(metavar="TOPIC", help="Default: all.", autocompletion=completion.topics),
    ] = None,
    *,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
    endpoint: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where the plotter connects; this host only.")
    ] = "tcp://127.0.0.1:9872",
    rate: Annotated[
        float, typer.Option("--rate", "-r", min=0.0, help="Most points per second of a topic; 0: all.")
    ] = 200.0,
    graph: GraphOption = None,
) -> None:
    """Send a running graph's numbers to a plotter.

    PlotJuggler takes them with its "ZMQ Subscriber", protocol msgpack.

    Each point is two frames, topic and a msgpack map; its field "timestamp" is its time in s on the graph's
    clock ("use field as timestamp"). Blocks of samples are sent sample by sample, arrays as lists.
    """
    from palp_core.cli.topic.tap_feed import TapFeed
    from palp_core.errors import GraphError
    from palp_core.graph.bag.selection import topic_selection
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.message_text import decoded

    running = find_graph(graph)
    named = {running.topic(topic).name for topic in topics or ()}
    chosen = topic_selection(named, regex, exclude_regex)
    entries = {entry.name: entry for entry in running.topics() if chosen(entry.name)}
    if not entries:
        raise GraphError(f"graph '{running.record.graph}' has no such topic")
    try:
        feed = TapFeed(endpoint, rate)
    except OSError as error:
        raise GraphError(f"{error.strerror}; choose another --endpoint") from error
    try:
        with until_ctrl_c(), TopicReader(running, list(entries.values())) as listener:
            note(
                f"{counted(len(entries), 'topic')} of graph '{running.record.graph}' at "
                f"{feed.endpoint}; Ctrl-C ends"
            )
            for heard in listener.messages():
                if heard is None or not heard.is_message:
                    continue
                name = heard.frame.topic
                feed.send(name, decoded(heard.frame.payload, entries[name].json_schema), heard.frame.stamp_ns)
        note(f"graph '{running.record.graph}' has ended; {counted(feed.sent_count, 'point')} sent")
    finally:
        feed.close()
