"""Options and arguments that many verbs share."""

import contextlib
from collections.abc import Iterator
from typing import Annotated, Literal

import typer

from palp_core.cli import completion

INTERRUPTED = 130

GraphOption = Annotated[
    str | None,
    typer.Option(
        "--graph",
        metavar="GRAPH",
        help="Which running graph: its name, id or pid; default: the one of this folder.",
        autocompletion=completion.graphs,
    ),
]
Level = Literal["debug", "info", "warning", "error", "critical"]
LevelOption = Annotated[
    Level | None, typer.Option("--level", help="At least so, with the lines that belong to it.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="For machines.")]
HiddenOption = Annotated[
    bool,
    typer.Option("-a", "--include-hidden-topics", "--include-hidden", help="Names that begin with _, too."),
]
TimeoutOption = Annotated[
    float, typer.Option("--timeout", metavar="S", min=0.0, help="Seconds to wait for a node's answer.")
]
RegexOption = Annotated[
    str | None, typer.Option("--regex", "-e", metavar="REGEX", help="Topics in which it is found.")
]
ExcludeRegexOption = Annotated[
    str | None,
    typer.Option("--exclude-regex", "-x", metavar="REGEX", help="Not topics in which it is found."),
]
TopicArgument = Annotated[
    str,
    typer.Argument(
        metavar="TOPIC", help="As in /estimator/belief.", autocompletion=completion.topics, show_default=False
    ),
]
TopicsArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="TOPIC",
        help="As in /estimator/belief.",
        autocompletion=completion.topics,
        show_default=False,
    ),
]
NodeArgument = Annotated[
    str,
    typer.Argument(
        metavar="NODE", help="As in /estimator.", autocompletion=completion.nodes, show_default=False
    ),
]
OptionalNodeArgument = Annotated[
    str | None,
    typer.Argument(metavar="NODE", help="Default: all.", autocompletion=completion.nodes, show_default=False),
]
ServiceArgument = Annotated[
    str,
    typer.Argument(
        metavar="SERVICE", help="As in /torque/tare.", autocompletion=completion.services, show_default=False
    ),
]


@contextlib.contextmanager
def until_ctrl_c() -> Iterator[None]:
    """Take Ctrl-C for the end that it is: no traceback, no "Aborted", status 130.

    Raises:
        typer.Exit: Ctrl-C.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None
