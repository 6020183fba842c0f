"""``palp methods``: every exchangeable method with its cost, its error, where it fails and what survives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import note, print_json, print_text, print_wrapped

if TYPE_CHECKING:
    from palp_core.methods import Candidate, Method
    from palp_core.palpation.session.method_choices import TaskChoice


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
        print_wrapped(f"{one.task.name}: {one.task.question} (cost: {one.task.per}; {asked})")
        print_text("method  cost  error")
        _print_methods(one)
        if one.chosen is None:
            print_text("None is good enough here: relax the tolerance, or declare a finer method.")
        if task:
            print_text("")
            for declared, _ in one.declared():
                print_wrapped(f"{declared.name}: {declared.what}", indent=2)
        print_text("")
    note(f"This machine takes {slowness():.2f} times as long as the one where costs were measured.")


def _print_methods(choice: TaskChoice) -> None:
    """Write each method as a line with its cost and error, and its sentences below."""
    from palp_core.methods.choice import amount, seconds

    for declared, offer in choice.declared():
        error = "-" if offer.bound is None else amount(offer.bound, choice.output)
        print_wrapped(f"{declared.name}  {seconds(declared.cost_s)}  {error}")
        print_wrapped(offer.why if offer.mark == "reference" else f"{offer.mark}: {offer.why}", indent=4)
        if declared.fails:
            print_wrapped(f"fails: {declared.fails}", indent=4)
        if declared.survivor:
            print_wrapped(f"survivor: {declared.survivor}", indent=4)


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
