"""``palp topic``: the topics of the running graph."""

from __future__ import annotations

from palp_core.cli.lazy import Verb, lazy_app

__all__ = ["app"]

_CLI = "palp_core.cli"

app = lazy_app(
    "Topics of the running graph.",
    {
        "list": Verb(f"{_CLI}.topic_list:list_topics", "List the topics."),
        "info": Verb(f"{_CLI}.topic_list:info", "Tell who publishes and who reads a topic."),
        "type": Verb(f"{_CLI}.topic_list:type_", "Tell the type of a topic's messages."),
        "find": Verb(f"{_CLI}.topic_list:find", "List the topics of a type."),
        "echo": Verb(f"{_CLI}.topic_echo:echo", "Print messages as they are published."),
        "hz": Verb(f"{_CLI}.topic_hz:hz", "Tell the rate of topics, by their own counters."),
        "bw": Verb(f"{_CLI}.topic_bw:bw", "Tell the bandwidth of topics."),
        "delay": Verb(f"{_CLI}.topic_delay:delay", "Tell the latency that readers have counted."),
        "pub": Verb(f"{_CLI}.topic_pub:pub", "Publish into a port that takes messages from outside."),
        "plot": Verb(f"{_CLI}.topic_plot:plot", "Plot fields of a topic in the terminal."),
    },
)
