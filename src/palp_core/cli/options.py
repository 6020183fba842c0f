"""Options and arguments that many verbs share, and what a verb about a running graph is called with."""

from __future__ import annotations

import contextlib
import functools
import inspect
import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from inspect import Parameter
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from palp_core.cli import completion
from palp_core.cli.output import note, print_text, show
from palp_core.cli.running import find_graph

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph

INTERRUPTED = 130
TERMINATED = 143


def _require_finite(value: Any) -> Any:
    """Refuse NaN, which is within all of typer's bounds, and infinity."""
    if isinstance(value, float) and not math.isfinite(value):
        raise typer.BadParameter("must be a finite number")
    return value


def option(text: str, *names: str, **settings: Any) -> Any:
    """Return an option; ``names`` as in ``--rate``, ``-r``, by default its parameter's."""
    return typer.Option(*names, help=text, **{"callback": _require_finite, **settings})


def argument(
    text: str,
    metavar: str | None = None,
    *,
    complete: Callable[..., list[str]] | None = None,
    **settings: Any,
) -> Any:
    """Return an argument, whose default is shown only if ``show_default`` says so."""
    shown = {"show_default": False, "callback": _require_finite, **settings}
    return typer.Argument(metavar=metavar, help=text, autocompletion=complete, **shown)


GraphOption = Annotated[
    str | None,
    option(
        "Running graph's name, id or pid; default: this folder's.",
        "--graph",
        metavar="GRAPH",
        autocompletion=completion.graphs,
    ),
]
Level = Literal["debug", "info", "warning", "error", "critical"]
LevelOption = Annotated[Level | None, option("Lowest level shown, with continuation lines.", "--level")]
JsonOption = Annotated[bool, option("Print JSON.", "--json")]
HiddenOption = Annotated[
    bool, option("Names that begin with _, too.", "-a", "--include-hidden-topics", "--include-hidden")
]
TimeoutOption = Annotated[
    float, option("Seconds to wait for a node's answer.", "--timeout", metavar="S", min=0.0)
]
RegexOption = Annotated[str | None, option("Only topics that match.", "--regex", "-e", metavar="REGEX")]
ExcludeRegexOption = Annotated[
    str | None, option("Leave out topics that match.", "--exclude-regex", "-x", metavar="REGEX")
]
TopicArgument = Annotated[str, argument("As in /estimator/belief.", "TOPIC", complete=completion.topics)]
TopicsArgument = Annotated[
    list[str], argument("As in /estimator/belief.", "TOPIC", complete=completion.topics)
]
NodeArgument = Annotated[str, argument("As in /estimator.", "NODE", complete=completion.nodes)]
OptionalNodeArgument = Annotated[str | None, argument("Default: all.", "NODE", complete=completion.nodes)]
ServiceArgument = Annotated[str, argument("As in /torque/tare.", "SERVICE", complete=completion.services)]


@contextlib.contextmanager
def until_ctrl_c() -> Iterator[None]:
    """Take Ctrl-C for the end that it is: no traceback, no "Aborted", status 130."""
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None


class Call:
    """How a verb about a running graph was called: what ``--graph``, ``--timeout`` and ``--json`` give it."""

    def __init__(self, name: str | None, timeout_s: float, *, as_json: bool, changes: bool) -> None:
        self.name, self.timeout_s, self.as_json = name, timeout_s, as_json
        self._changes = changes

    @functools.cached_property
    def graph(self) -> RunningGraph:
        return find_graph(self.name, changes=self._changes)

    def show(self, value: Any, lines: Iterable[str], *, count: bool = False) -> None:
        """Print a value as JSON, or else lines of text; or only how many there are in the value."""
        if count:
            print_text(str(len(value)))
        else:
            show(value, lines, as_json=self.as_json)

    def show_of_type(
        self,
        wanted: str,
        types: Mapping[str, Iterable[str]],
        what: str,
        shown: Container[str] | None = None,
        *,
        count: bool = False,
    ) -> None:
        """Print the names, of those to be shown, that have a type; ``what`` has types, for the error."""
        from palp_core.errors import GraphError
        from palp_core.graph.problems import hint

        if wanted not in (known := {kind for kinds in types.values() for kind in kinds}):
            raise GraphError(f"no {what} '{wanted}'{hint(wanted, known)}")
        names = [
            name for name, kinds in types.items() if wanted in kinds and (shown is None or name in shown)
        ]
        self.show(names, names, count=count)

    def note_silent(self, silent: dict[str, Any]) -> None:
        for error in silent.values():
            note(str(error))


def graph_verb(
    *, timeout_s: float | None = None, changes: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a verb, whose first parameter is a :class:`Call`, the options of verbs about a running graph.

    ``timeout_s`` is the default of ``--timeout``; None: no such option. ``changes``: see :func:`find_graph`.
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
