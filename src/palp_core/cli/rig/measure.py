"""``palp methods measure``: error and CPU time of every method, here and now."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.options import INTERRUPTED, JsonOption, argument, option
from palp_core.cli.output import note, print_json, print_table, print_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from palp_core.methods.measured import Measured
    from palp_core.palpation.session.method_choices import TaskChoice

_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h)")
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def duration_s(text: str) -> float:
    """Return a duration as one types it, in s.

    >>> duration_s("60s"), duration_s("2min")
    (60.0, 120.0)
    """
    found = _DURATION.fullmatch(text.strip())
    if found is None or float(found[1]) == 0.0:
        raise typer.BadParameter(f"'{text}' is no duration; write 60s, 2min or 1h")
    return float(found[1]) * _UNITS[found[2]]


def measure(
    scene: Annotated[Path | None, argument("Scene file; default: the published rig.")] = None,
    *,
    task: Annotated[list[str] | None, option("Only this task, as in contact; may be given again.")] = None,
    budget: Annotated[str, option("After how long no further point is begun: 60s, 2min, 1h.")] = "60s",
    as_json: JsonOption = False,
) -> None:
    """All tasks in turns, a point of each. When time is up, or on Ctrl-C, the tables have what there is."""
    from palp_core.methods import left_out
    from palp_core.methods import task as task_of
    from palp_core.methods.measured import Survey, measured_tasks, slowness
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.scene import Scene
    from palp_core.palpation.session.method_choices import AUTO, choose_for, launch_defaults

    budget_s = duration_s(budget)
    given = read_scene(scene) if scene else Scene()
    names = list(dict.fromkeys(task)) if task else measured_tasks()
    survey = Survey(names, given)
    for text in left_out():
        note(f"left out: {text}")
    interrupted = False
    try:
        survey.measure(budget_s)
    except KeyboardInterrupt:
        interrupted = True
    for text in survey.missing:
        note(f"left out: {text}")
    if as_json:
        print_json([vars(one) | {"slowness": slowness()} for one in survey.points])
    else:
        defaults = launch_defaults()
        for name in names:
            choice = choose_for(task_of(name), given, default=defaults.get(name, AUTO))
            print_text(f"{name}: error of {choice.output} against CPU time of {choice.task.per}")
            print_table(
                [("method", "setting", "cost", "error", "bound", "mark"), *_rows(choice, survey.points)]
            )
            print_text("")
        note(f"This machine takes {slowness():.2f} times as long as the one where costs were measured.")
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if survey.failed:
        raise typer.Exit(1)


def _rows(choice: TaskChoice, points: Iterable[Measured]) -> Iterator[tuple[str, ...]]:
    """Give a row per point of the output that is asked for, or one for a method that was not measured."""
    from palp_core.methods.choice import amount, seconds

    for method, offer in choice.declared():
        bound = "-" if offer.bound is None else amount(offer.bound, choice.output)
        own = [one for one in points if (one.task, one.method) == (choice.task.name, method.name)]
        own = [one for one in own if one.output == choice.output]
        if not own:
            yield method.name, "", "not measured", "", bound, offer.mark
        for one in own:
            setting = ", ".join(filter(None, (one.setting, one.condition)))
            error = one.fails or amount(one.error, one.output)
            yield method.name, setting, seconds(one.cost_s), error, bound, offer.mark
