"""``palp methods``: every exchangeable method with its cost, its error, where it fails and what survives."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import note, print_json, print_table, print_text

if TYPE_CHECKING:
    from rich.console import Console

    from palp_core.methods import Candidate, Method
    from palp_core.palpation.session.method_choices import TaskChoice

_HEAD = ["method", "cost", "error", "in this scene", "where it fails", "survivor"]
_SENTENCES = ("in this scene", "where it fails")
_LEAST_SENTENCE, _GAP = 28, 3
_STYLES = {"chosen": "bold green", "valid": "", "refused": "dim", "reference": "dim"}


def methods(
    task: Annotated[str, typer.Argument(help="Only this task's, as in contact.")] = "",
    *,
    scene: Annotated[
        Path | None, typer.Option(help="Scene file to mark them for; default: the published rig.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the methods of every task, cheapest first, and which of them a scene gets.

    Costs are seconds of one core on the machine where they were measured, errors relative unless the output
    is a time. A method is chosen, valid (good enough, but dearer), refused, or a reference (to compare with,
    never chosen). Runs obey the choice where their launch file does not name a method. Of one task it also
    says what each method is. A survivor is what to name where a method fails; no run changes over to it by
    itself.
    """
    from palp_core.methods import left_out, tasks
    from palp_core.methods import task as task_of
    from palp_core.methods.choice import amount
    from palp_core.methods.machine import UNIT_S, slowness
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.scene import Scene
    from palp_core.palpation.session.method_choices import choose_for

    given = read_scene(scene) if scene else Scene()
    found = [choose_for(one, given) for one in ([task_of(task)] if task else tasks())]
    for words in left_out(task):
        note(f"left out: {words}")
    if as_json:
        here = {"unit_s": UNIT_S, "slowness": slowness()}
        print_json([_record(one, *pair) | here for one in found for pair in one.declared()])
        return
    for one in found:
        asked = f"asked here: {one.output} within {amount(one.tolerance, one.output)}"
        print_text(f"{one.task.name}: {one.task.question} (cost: {one.task.per}; {asked})")
        if sys.stdout.isatty():
            _print_wrapped(one)
        else:
            print_table([_HEAD, *(cells for cells, _ in _rows(one))])
        if one.chosen is None:
            print_text("None is good enough here: relax the tolerance, or declare a finer method.")
        if task:
            print_text("")
            for declared, _ in one.declared():
                print_text(f"  {declared.name}: {declared.what}")
        print_text("")
    note(f"This machine takes {slowness():.2f} times as long as the one where costs were measured.")


def _rows(choice: TaskChoice) -> Iterator[tuple[list[str], str]]:
    """Yield a row per method, and its mark."""
    from palp_core.methods.choice import amount, seconds

    for declared, offer in choice.declared():
        error = "-" if offer.bound is None else amount(offer.bound, choice.output)
        mark = offer.why if offer.mark == "reference" else f"{offer.mark}: {offer.why}"
        fails, survivor = declared.fails or "-", declared.survivor or "-"
        yield [declared.name, seconds(declared.cost_s), error, mark, fails, survivor], offer.mark


def _print_wrapped(choice: TaskChoice) -> None:
    """Write the rows as wide as the terminal is; one below the other where sentences would have no room."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console, rows = Console(highlight=False), list(_rows(choice))
    words = [i for i, name in enumerate(_HEAD) if name not in _SENTENCES]
    taken = sum(max(len(cells[i]) for cells, _ in [(_HEAD, ""), *rows]) + _GAP for i in words)
    if console.width < taken + len(_SENTENCES) * _LEAST_SENTENCE:
        _print_one_by_one(console, rows)
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for name in _HEAD:
        table.add_column(name, no_wrap=name not in _SENTENCES, ratio=3 if name in _SENTENCES else None)
    for cells, mark in rows:
        table.add_row(*map(escape, cells), style=_STYLES[mark])
    console.print(table)


def _print_one_by_one(console: Console, rows: Sequence[tuple[list[str], str]]) -> None:
    """Write each method as a line with what is short of it, and its sentences below."""
    from rich.padding import Padding
    from rich.text import Text

    for (name, cost, error, marked, fails, survivor), mark in rows:
        console.print(Text(f"{name}  {cost}  {error}"), style=_STYLES[mark])
        for words in (marked, f"fails: {fails}", f"survivor: {survivor}"):
            if not words.endswith(": -"):
                console.print(Padding(Text(words), (0, 0, 0, 4), expand=False), style=_STYLES[mark])


def _record(choice: TaskChoice, declared: Method, offer: Candidate) -> dict[str, Any]:
    """Return a method as an object: as it is declared, and what it offers in the scene."""
    return {
        "task": declared.task,
        "name": declared.name,
        "what": declared.what,
        "cost_s": declared.cost_s,
        "per": choice.task.per,
        "output": choice.output,
        "error": offer.bound,
        "errors": [
            {"output": one.output, "error": one.error, "within": dict(one.within)} for one in declared.bounds
        ],
        "valid": dict(declared.valid),
        "evidence": declared.evidence,
        "fails": declared.fails,
        "survivor": declared.survivor,
        "reference": declared.reference,
        "mark": offer.mark,
        "why": offer.why,
        "module": declared.module,
    }
