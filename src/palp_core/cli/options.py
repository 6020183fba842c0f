"""Options and arguments that many verbs share, and what a verb about a running graph is called with."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import Parameter
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from palp_core.cli import completion
from palp_core.cli.output import note, print_text, show
from palp_core.cli.running import find_graph

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph

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


class Call:
    """How a verb about a running graph was called: what ``--graph``, ``--timeout`` and ``--json`` give it.

    Attributes:
        name: What ``--graph`` names.
        timeout_s: Seconds to wait for a node's answer.
        as_json: The output is for machines.
    """

    def __init__(self, name: str | None, timeout_s: float, *, as_json: bool, changes: bool) -> None:
        self.name, self.timeout_s, self.as_json = name, timeout_s, as_json
        self._changes = changes

    @functools.cached_property
    def graph(self) -> RunningGraph:
        """The running graph; see :func:`find_graph`."""
        return find_graph(self.name, changes=self._changes)

    def show(self, value: Any, lines: Iterable[str], *, count: bool = False) -> None:
        """Print a value as JSON, or else lines of text; or only how many there are in the value."""
        if count:
            print_text(str(len(value)))
        else:
            show(value, lines, as_json=self.as_json)

    def show_of_type(self, wanted: str, types: Mapping[str, Iterable[str]], what: str) -> None:
        """Print the names that have a type.

        Args:
            wanted: The type.
            types: Types by name.
            what: What takes or has the type, for the error.

        Raises:
            GraphError: None has it; the nearest type is in the message.
        """
        from palp_core.errors import GraphError
        from palp_core.graph.problems import hint

        known = {one for of_name in types.values() for one in of_name}
        if wanted not in known:
            raise GraphError(f"no {what} '{wanted}'{hint(wanted, known)}")
        names = [name for name, of_name in types.items() if wanted in of_name]
        self.show(names, names)

    def note_silent(self, silent: dict[str, Any]) -> None:
        for error in silent.values():
            note(str(error))


def graph_verb(
    *, timeout_s: float | None = None, changes: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a verb, whose first parameter is a :class:`Call`, the options that all verbs about a graph have.

    Args:
        timeout_s: Default of ``--timeout``; None: the verb has no such option.
        changes: The verb changes the graph: if several may be meant, none is taken.
    """

    def decorate(verb: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(verb)
        def call(*, graph: str | None, as_json: bool, **given: Any) -> None:
            wait_s: float = 0.0 if timeout_s is None else given.pop("timeout")
            with until_ctrl_c():
                verb(Call(graph, wait_s, as_json=as_json, changes=changes), **given)

        signature = inspect.signature(verb, eval_str=True)
        shared: dict[str, tuple[Any, Any]] = {"graph": (GraphOption, None), "as_json": (JsonOption, False)}
        if timeout_s is not None:
            shared = {"timeout": (TimeoutOption, timeout_s), **shared}
        parameters = [
            *list(signature.parameters.values())[1:],
            *(
                Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
                for name, (kind, default) in shared.items()
            ),
        ]
        call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return call

    return decorate
