"""Groups whose verbs are imported when they are called, so that ``palp --help`` imports none of them."""

import errno
import importlib
import inspect
import os
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import typer
import typer.core
import typer.main

from palp_core.errors import PalpError

SIGPIPE_STATUS = 141


class Verb(NamedTuple):
    """A verb that is not imported yet, ``module:name`` of a function or a :class:`typer.Typer`, and its line.

    ``part`` is the heading under which the help lists it; "": that of the verb before it.
    """

    target: str
    help: str
    part: str = ""


class LazyGroup(typer.core.TyperGroup):
    """A group of stand-ins with name and help; the verb that is called is imported."""

    verbs: dict[str, Verb] = {}

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for name, verb in self.verbs.items():
            self.add_command(typer.core.TyperCommand(name, short_help=verb.help), name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the verbs under their headings, never cut off."""
        parts: dict[str, list[tuple[str, str]]] = {}
        part = "Commands"
        width = max(map(len, self.verbs))
        for name, verb in self.verbs.items():
            part = verb.part or part
            parts.setdefault(part, []).append((f"{name:<{width}}", verb.help))
        for title, rows in parts.items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find the verb that the first argument names, and import it."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else load(name, self.verbs[name]), rest

    def invoke(self, ctx: Any) -> Any:
        """Run the verb; a reader of its output that has gone (``| head``) ends it as SIGPIPE does."""
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
        except BrokenPipeError:
            _discard_output()
            raise typer.Exit(SIGPIPE_STATUS) from None
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            _discard_output()
            raise PalpError(
                f"{error.filename or 'the output'} cannot be written: {error.strerror}"
            ) from error
        return result


def _discard_output() -> None:
    """Let what is still buffered go nowhere, so that the end of the process does not try it again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)


def load(name: str, verb: Verb) -> Any:
    """Return the command of a verb; its help is plain text, which is quick."""
    module_name, _, attribute = verb.target.partition(":")
    target = getattr(importlib.import_module(module_name), attribute)
    if isinstance(target, typer.Typer):
        target.rich_markup_mode = None
        target.info.help = verb.help
        target.info.no_args_is_help = True
        return typer.main.get_group(target)
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name, help=f"{verb.help}\n\n{inspect.getdoc(target) or ''}")(target)
    return typer.main.get_command(app)


def lazy_app(
    verbs: dict[str, Verb], *, text: str = "", callback: Callable[..., None] = lambda: None
) -> typer.Typer:
    """Return an application of verbs that are imported when they are called."""
    return typer.Typer(
        cls=type("Verbs", (LazyGroup,), {"verbs": verbs}),
        help=text,
        callback=callback,
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
