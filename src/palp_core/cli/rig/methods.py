"""``palp methods list``: exchangeable methods with cost, error and state, and which of them a run takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import note, print_json, print_text, print_wrapped

if TYPE_CHECKING:
    from palp_core.methods import Candidate, Method
    from palp_core.palpation.session.method_choices import TaskChoice


_HERE = "palp_core.cli.rig"

app = lazy_app(
    {
        "list": Verb(f"{_HERE}.methods:list_methods", "List the methods of every task, cheapest first."),
        "why": Verb(f"{_HERE}.why:why", "Show which methods a run used, and why."),
        "measure": Verb(f"{_HERE}.measure:measure", "Measure error and CPU time of every method."),
    }
)


def list_methods(
    task: Annotated[str, argument("Only this task's, as in contact.")] = "",
    *,
    scene: Annotated[Path | None, option("Scene file to mark them for; default: the published rig.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Costs are seconds of one core on the machine where they were measured; errors are relative. A method is
    chosen (the cheapest that is accurate enough), default (published) (launch/sim.yaml takes it), not
    accurate enough, or not available here (the scene is outside its range, or it is a reference). One
    without a state is accurate enough, but more expensive. A survivor is what to name where a method fails;
    no run changes over to it by itself.
    """
    from palp_core.methods import left_out, tasks
    from palp_core.methods import task as task_of
    from palp_core.methods.choice import amount
    from palp_core.methods.measured import UNIT_S, slowness
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.scene import Scene
    from palp_core.palpation.session.method_choices import AUTO, choose_for, launch_defaults

    given = read_scene(scene) if scene else Scene()
    defaults = launch_defaults()
    found = [
        choose_for(one, given, default=defaults.get(one.name, AUTO))
        for one in ([task_of(task)] if task else tasks())
    ]
    for text in left_out(task):
        note(f"left out: {text}")
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
            print_text("None is accurate enough here: relax the tolerance, or declare a finer method.")
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
        print_wrapped("; ".join([offer.state, *_taken_by(choice, offer)]), indent=4)
        if declared.fails:
            print_wrapped(f"fails: {declared.fails}", indent=4)
        if declared.survivor:
            print_wrapped(f"survivor: {declared.survivor}", indent=4)


def _taken_by(choice: TaskChoice, offer: Candidate) -> list[str]:
    """Return which run takes a method, and what the default costs."""
    from palp_core.methods.choice import CHOSEN, DEFAULT
    from palp_core.palpation.session.method_choices import AUTO

    if offer.mark == CHOSEN:
        by_default = choice.default in (AUTO, offer.name)
        return ["launch/sim.yaml takes it" if by_default else f"{choice.task.name}:={AUTO} takes it"]
    if offer.mark == DEFAULT and choice.chosen is not None and choice.points is not None:
        than = "worse" if choice.points >= 0.0 else "better"
        return [f"{abs(choice.points):.1f} points {than} than {choice.chosen.name}"]
    return []


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
        "taken_by": _taken_by(choice, offer),
        "why": offer.why,
        "module": declared.module,
    }
