"""``palp methods``: the exchangeable methods, what they cost here, and what a run used."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import INTERRUPTED, JsonOption, argument, option
from palp_core.cli.output import note, print_json, print_table, print_text, print_wrapped
from palp_core.counted import counted
from palp_core.errors import GraphError, PalpError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from palp_core.graph.launch.summary import RunSummary
    from palp_core.methods import Candidate, Method
    from palp_core.methods.measured import Measured
    from palp_core.palpation.mechanics.scene.scene import Scene
    from palp_core.palpation.session.method_choices import TaskChoice
    from palp_core.palpation.session.trials_csv import Row

_HERE = "palp_core.cli.rig.methods"

app = lazy_app(
    {
        "list": Verb(f"{_HERE}:list_methods", "List the methods of every task, cheapest first."),
        "why": Verb(f"{_HERE}:why", "Show which methods a run used, and why."),
        "measure": Verb(f"{_HERE}:measure", "Measure error and CPU time of every method."),
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

    given = _scene(scene)
    found = _choices([one.name for one in ([task_of(task)] if task else tasks())], given)
    for text in left_out():
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
    _note_slowness()


def _scene(file: Path | None) -> Scene:
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.scene import Scene

    return read_scene(file) if file else Scene()


def _choices(tasks: Iterable[str], scene: Scene) -> list[TaskChoice]:
    from palp_core.methods import task
    from palp_core.palpation.session.method_choices import AUTO, choose_for, launch_defaults

    defaults = launch_defaults()
    return [choose_for(task(name), scene, default=defaults.get(name, AUTO)) for name in tasks]


def _note_slowness() -> None:
    from palp_core.methods.measured import slowness

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
    names = ("task", "name", "what", "cost_s", "evidence", "fails", "survivor", "reference", "module")
    return {
        **{name: getattr(declared, name) for name in names},
        "per": choice.task.per,
        "output": choice.output,
        "error": offer.bound,
        "errors": [
            {"output": one.output, "error": one.error, "within": dict(one.within)} for one in declared.bounds
        ],
        "valid": dict(declared.valid),
        "mark": offer.mark,
        "taken_by": _taken_by(choice, offer),
        "why": offer.why,
    }


def measure(
    scene: Annotated[Path | None, argument("Scene file; default: the published rig.")] = None,
    *,
    task: Annotated[list[str] | None, option("Only this task, as in contact; may be given again.")] = None,
    budget: Annotated[float, option("After it no further point is begun.", metavar="S", min=1e-3)] = 60.0,
    as_json: JsonOption = False,
) -> None:
    """All tasks in turns, a point of each. When time is up, or on Ctrl-C, the tables have what there is."""
    from palp_core.methods import left_out
    from palp_core.methods.measured import Survey, measured_tasks, slowness

    given = _scene(scene)
    names = list(dict.fromkeys(task)) if task else measured_tasks()
    survey, interrupted = Survey(names, given), False
    missing = left_out()
    try:
        survey.measure(budget)
    except KeyboardInterrupt:
        interrupted = True
    for text in [*missing, *survey.missing]:
        note(f"left out: {text}")
    if as_json:
        print_json([vars(one) | {"slowness": slowness()} for one in survey.points])
    else:
        for choice in _choices(names, given):
            print_text(f"{choice.task.name}: error of {choice.output} against CPU time of {choice.task.per}")
            heads = ("method", "setting", "cost", "stated", "error", "bound", "mark")
            print_table([heads, *_measured_rows(choice, survey.points)])
            print_text("")
        _note_slowness()
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if survey.failed:
        raise typer.Exit(1)


def _measured_rows(choice: TaskChoice, points: Iterable[Measured]) -> Iterator[tuple[str, ...]]:
    """Give a row per point of the output that is asked for, or one for a method that was not measured."""
    from palp_core.methods.choice import amount, seconds
    from palp_core.methods.measured import slowness

    for method, offer in choice.declared():
        bound = "-" if offer.bound is None else amount(offer.bound, choice.output)
        key = choice.task.name, method.name, choice.output
        stated = seconds(method.cost_s * slowness())
        own = [one for one in points if (one.task, one.method, one.output) == key]
        if not own:
            yield method.name, "", "not measured", stated, "", bound, offer.mark
        for one in own:
            setting = ", ".join(filter(None, (one.setting, one.condition)))
            error = one.fails or amount(one.error, one.output)
            yield method.name, setting, seconds(one.cost_s), stated, error, bound, offer.mark


def why(
    run: Annotated[str, argument("Session's folder, bag or running graph; default: that.", "RUN")] = "",
    *,
    as_json: JsonOption = False,
) -> None:
    """All of it is what the run itself has recorded; nothing is computed again."""
    from palp_core.methods import left_out
    from palp_core.palpation.session.methods.record import methods_of, paragraphs, unsaid

    summary, rows = _recorded(run)
    record = methods_of(summary, rows)
    if summary.ended:
        note(f"not the whole run: {summary.ended}; this is of the {counted(len(rows), 'palpation')} so far")
    elif not rows:
        note(f"'{run}' has no palpation, so uses and checks of its methods are unknown")
    for text in [*unsaid(summary, rows), *(f"left out: {one}" for one in left_out())]:
        note(text)
    if as_json:
        print_json(record)
        return
    for heading, sentences in paragraphs(record):
        print_wrapped(heading)
        for sentence in sentences:
            print_wrapped(sentence, indent=4)


def _recorded(run: str) -> tuple[RunSummary, list[Row]]:
    """Return what a folder, a bag or a running graph has recorded so far."""
    from palp_core.palpation.session.bag_record import is_bag, read_record
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.session_folder import RUN, is_being_written
    from palp_core.palpation.session.trials_csv import read_rows

    path = Path(run)
    if not run or not path.exists():
        return _running(run)
    if is_bag(path):
        found = read_record(path)
        return found.summary, found.rows
    if not (path / RUN).is_file():
        raise PalpError(f"'{path}' is neither a session's folder ({RUN} is missing) nor a bag, so no run")
    summary = read_note(path)
    if is_being_written(path):
        with contextlib.suppress(PalpError):  # it has ended meanwhile, or it runs in a folder of its own
            return _running(summary.run)
    return summary, read_rows(path)


def _running(name: str) -> tuple[RunSummary, list[Row]]:
    import msgspec

    from palp_core.cli.running import find_graph
    from palp_core.graph.launch.summary import RunSummary
    from palp_core.graph.node.spec import LAUNCHER
    from palp_core.palpation.session.roles import NoSession, roles_of
    from palp_core.palpation.session.run_note import out_of, read_note
    from palp_core.palpation.session.trials_csv import read_rows

    try:
        graph = find_graph(name or None)
    except GraphError as error:
        if name:
            text = f"'{name}' is no folder of a session, no bag and no running graph: {error}"
        else:
            text = f"{error}; or name a session's folder or a bag: palp methods why results/latest"
        raise PalpError(text) from error
    summary = msgspec.convert(graph.ask(LAUNCHER, "summary")["summary"], RunSummary)
    try:
        roles_of(summary)
    except NoSession as error:
        raise PalpError(f"graph '{summary.graph}' runs, but is no session: {error.why}") from error
    summary = msgspec.structs.replace(summary, ended="it is still running")
    folder = Path(graph.record.launched_from, out_of(summary))
    try:
        begun = read_note(folder).run == summary.run
    except PalpError:
        begun = False  # no palpation yet: the folder is taken with the first
    return summary, read_rows(folder) if begun else []
