"""The reference of the command line, made from the verbs themselves."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import typer

from palp_core.cli.lazy import LazyGroup, Verb, load
from palp_core.cli.main import app


def verbs_page() -> str:
    """Return every verb and flag as Markdown."""
    parts = ["\n## palp\n\n", *_table(typer.main.get_command(app), "palp")]
    for name, command in commands():
        parts += [f"\n## palp {name}\n\n", *_verb(command, f"palp {name}")]
        for inner, verb in getattr(command, "commands", {}).items():
            whole = load(inner, command.verbs[inner]) if isinstance(command, LazyGroup) else verb
            parts += [f"\n### palp {name} {inner}\n\n", *_verb(whole, f"palp {name} {inner}")]
    return "".join(parts)


def verb_lines() -> Iterator[tuple[str, str]]:
    """Yield each verb of the first level with its line of help."""
    yield "verb", "effect"
    for name, verb in _verbs().items():
        yield f"`palp {name}`", verb.help


def commands() -> Iterator[tuple[str, Any]]:
    """Yield each verb and group of the first level, by name."""
    for name, verb in _verbs().items():
        yield name, load(name, verb)


def _verbs() -> dict[str, Verb]:
    kind = app.info.cls
    assert isinstance(kind, type)
    assert issubclass(kind, LazyGroup)
    return kind.verbs


def _verb(command: Any, path: str) -> Iterator[str]:
    yield _prose(command.help or "") + "\n\n"
    if hasattr(command, "commands"):
        return
    with typer.Context(command, info_name=path) as context:
        pieces = " ".join(command.collect_usage_pieces(context))
        yield f"`{path} {pieces}`\n\n"
    yield from _table(command, path)


def _table(command: Any, path: str) -> Iterator[str]:
    with typer.Context(command, info_name=path) as context:
        rows = [_row(parameter, context) for parameter in command.get_params(context)]
    if rows := [row for row in rows if row]:
        yield "| | effect |\n|---|---|\n"
        yield "".join(rows)


def _row(parameter: Any, context: Any) -> str:
    """Return a line for an argument or an option; the help's own option is everywhere and has none."""
    if "--help" in parameter.opts or getattr(parameter, "hidden", False):
        return ""
    record = parameter.get_help_record(context)
    if record is None:
        return ""
    names, text = record
    shown = _flat(text).replace("|", r"\|").replace("<", "&lt;").replace("[", r"\[")
    return f"| `{_flat(names)}` | {shown} |\n"  # a bar within code divides no cells


def _flat(text: str) -> str:
    return re.sub(r"\s+", " ", text).strip()


def _prose(text: str) -> str:
    """Return a docstring as paragraphs; what begins with a form feed is left out."""
    return text.partition("\f")[0].replace("<", "&lt;").strip()
