"""The verbs of ``palp topic``."""

from palp_core.cli.lazy import Verb, lazy_app

_CLI = "palp_core.cli"

app = lazy_app(
    {
        "list": Verb(f"{_CLI}.topic.list:list_topics", "List the topics."),
        "info": Verb(f"{_CLI}.topic.list:info", "Show who publishes and who reads a topic."),
        "type": Verb(f"{_CLI}.topic.list:type_", "Show the type of a topic's messages."),
        "find": Verb(f"{_CLI}.topic.list:find", "List the topics of a type."),
        "echo": Verb(f"{_CLI}.topic.echo:echo", "Print messages as they are published."),
        "hz": Verb(f"{_CLI}.topic.measure:hz", "Measure the rate of topics."),
        "bw": Verb(f"{_CLI}.topic.measure:bw", "Measure the bandwidth of topics."),
        "delay": Verb(f"{_CLI}.topic.measure:delay", "Show the latency that readers have counted."),
        "pub": Verb(f"{_CLI}.topic.pub:pub", "Publish into a port that takes messages from outside."),
    },
)
