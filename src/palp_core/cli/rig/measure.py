"""``palp methods measure``: error against time of every method, here and now."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import INTERRUPTED, until_ctrl_c
from palp_core.cli.output import make_folder, note, print_table, print_text

_HEAD = ("method", "setting", "cost", "error", "bound", "mark")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h)")
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def duration_s(text: str) -> float:
    """Return a duration as one types it, in s.

    >>> duration_s("60s"), duration_s("2min")
    (60.0, 120.0)

    Raises:
        typer.BadParameter: It is none.
    """
    found = _DURATION.fullmatch(text.strip())
    if found is None or float(found[1]) == 0.0:
        raise typer.BadParameter(f"'{text}' is no duration; write 60s, 2min or 1h")
    return float(found[1]) * _UNITS[found[2]]


def measure(
    scene: Annotated[
        Path | None, typer.Argument(help="Scene file; default: the published rig.", show_default=False)
    ] = None,
    *,
    task: Annotated[
        list[str] | None, typer.Option(help="Only this task, as in contact; may be given again.")
    ] = None,
    budget: Annotated[str, typer.Option(help="How long it may take: 60s, 2min, 1h.")] = "60s",
    out: Annotated[Path, typer.Option(help="Folder for page, charts, tables and tradeoff.json.")] = Path(
        "tradeoff"
    ),
    signature: Annotated[
        bool, typer.Option("--signature", help="The README's first picture instead: minutes, no budget.")
    ] = False,
    draw: Annotated[
        bool, typer.Option("--draw", help="With --signature: draw what was measured again, no more.")
    ] = False,
) -> None:
    """All tasks in turns, first the first point of each, the cheapest first. When time is up, or on Ctrl-C,
    the page has what there is.
    """
    from palp_core.methods import left_out
    from palp_core.methods import task as task_of
    from palp_core.methods.measured import measure_of, measured_tasks, unmeasurable
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.scene import Scene
    from palp_core.palpation.session.method_choices import AUTO, choose_for, launch_defaults
    from palp_core.palpation.studies.toolkit.progress import told
    from palp_core.palpation.studies.tradeoff.page import task_rows, write_tradeoff
    from palp_core.palpation.studies.tradeoff.survey import take

    if signature or draw:
        print_text(str(_signature(out, measured=not draw)))
        return
    budget_s = duration_s(budget)
    given = read_scene(scene) if scene else Scene()
    names = list(dict.fromkeys(task)) if task else measured_tasks()
    for name in task or ():
        measure_of(name)
    unmeasured = [words for name in names for words in unmeasurable(name)]
    defaults = launch_defaults()
    choices = [choose_for(task_of(name), given, default=defaults.get(name, AUTO)) for name in names]
    for words in left_out() + unmeasured:
        note(f"left out: {words}")
    make_folder(out)
    with told() as tell:
        survey = take(given, choices, budget_s=budget_s, tell=tell)
    if survey.ended == "interrupted":
        note("interrupted: the page is made of what there is; Ctrl-C again leaves it")
    with until_ctrl_c():
        page = write_tradeoff(survey, out)
    if survey.left_out:
        why = {"budget": "time was up", "interrupted": "interrupted"}.get(survey.ended, "not complete")
        note(f"{why}, and the page has what there was; left out: {survey.left_out}")
    for one in survey.tasks:
        asked = one.choice
        print_text(f"{asked.task.name}: error of {asked.output} against CPU time of {asked.task.per}")
        print_table([_HEAD, *(cells[: len(_HEAD)] for cells, _ in task_rows(one))])
        print_text("")
    print_text(str(page))
    if survey.ended == "interrupted":
        raise typer.Exit(INTERRUPTED)
    if survey.broken or unmeasured:
        raise typer.Exit(1)


def _signature(out: Path, *, measured: bool) -> Path:
    """Measure and draw the README's first picture, or only draw it; return it."""
    from palp_core.palpation.studies.toolkit.progress import told
    from palp_core.palpation.studies.tradeoff.signature import draw_signature, measure_signature

    if not measured:
        return draw_signature(out)
    make_folder(out)
    with until_ctrl_c(), told() as tell:
        return measure_signature(out, tell)
