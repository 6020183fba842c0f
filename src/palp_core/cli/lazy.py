"""Verb groups whose modules are imported when a verb is used, so that ``palp --help`` waits for nothing.

A group lists its verbs as text: where each lives, and the line that the help shows for it.
"""

import errno
import importlib
import os
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import typer
import typer.core
import typer.main

from palp_core.cli.plain_values import take_plainly
from palp_core.errors import PalpError

SIGPIPE_STATUS = 141


class Verb(NamedTuple):
    """A verb or a group of verbs that is not imported yet.

    Attributes:
        target: ``module:name`` of a function with Typer's annotations, or of a :class:`typer.Typer`.
        help: One line.
        hidden: Works, but is not listed.
        part: Heading under which the help lists it; "": that of the verb before it.
    """

    target: str
    help: str
    hidden: bool = False
    part: str = ""


class LazyGroup(typer.core.TyperGroup):
    """A group that lists what it knows of its verbs and imports the one that is called.

    Attributes:
        verbs: By name.
        default: The verb that is meant where the first word is none, as in ``palp graph FILE``.
    """

    verbs: dict[str, Verb] = {}
    default = ""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for name, verb in self.verbs.items():
            stand_in = typer.core.TyperCommand(name, help=verb.help, hidden=verb.hidden)
            self.add_command(stand_in, name)
        take_plainly(self)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the verbs under their headings."""
        shown = {name: verb for name, verb in self.verbs.items() if not verb.hidden}
        room = formatter.width - 6 - max(map(len, self.verbs), default=0)
        parts: dict[str, list[tuple[str, str]]] = {}
        part = "Commands"
        for name, verb in shown.items():
            part = verb.part or part
            said = self.commands[name].get_short_help_str(room)
            parts.setdefault(part, []).append((name, said))
        wide = max(map(len, shown), default=0)
        for title, rows in parts.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:<{wide}}", said) for name, said in rows])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the verb that is meant where none stands."""
        if self.default and args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = [self.default, *args]
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find the verb that the first argument names, and import it."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else load(name, self.verbs[name]), rest

    def invoke(self, ctx: Any) -> Any:
        """Run the verb; a reader of its output that has gone, as in ``... | head``, ends it as SIGPIPE does.

        Typer would end it with status 1, which says here that something is wrong.
        """
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
    """Return the command of a verb."""
    module_name, _, attribute = verb.target.partition(":")
    target = getattr(importlib.import_module(module_name), attribute)
    if isinstance(target, typer.Typer):
        target.rich_markup_mode = None
        return take_plainly(typer.main.get_group(target))
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name)(target)
    return take_plainly(typer.main.get_command(app))


def _no_options() -> None:
    """A group without its verb does nothing."""


def lazy_app(
    text: str,
    verbs: dict[str, Verb],
    *,
    default: str = "",
    add_completion: bool = False,
    callback: Callable[..., None] = _no_options,
) -> typer.Typer:
    """Return an application of verbs that are imported on use; its help is plain text, which is quick."""
    return typer.Typer(
        cls=type("Verbs", (LazyGroup,), {"verbs": verbs, "default": default}),
        help=text,
        callback=callback,
        no_args_is_help=True,
        add_completion=add_completion,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
