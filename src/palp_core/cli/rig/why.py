"""``palp methods why``: which methods a run used, why, what they met and what they cost."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from palp_core.cli.options import JsonOption, argument
from palp_core.cli.output import note, print_json, print_wrapped
from palp_core.counted import counted
from palp_core.errors import GraphError, PalpError

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary
    from palp_core.palpation.session.trials_csv import Row


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
        note(
            f"not the whole run: {summary.ended}; this is of the {counted(len(rows), 'palpation')} "
            "that there are"
        )
    elif not rows:
        note(f"'{run}' holds no palpation: what its methods met and how often they were used is not known")
    for text in unsaid(summary, rows):
        note(text)
    for text in left_out():
        note(f"left out of what there is to choose from: {text}")
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
            raise PalpError(
                f"'{name}' is no folder of a session, no bag and no running graph: {error}"
            ) from error
        raise PalpError(
            f"{error}; or name a session's folder or a bag: palp methods why results/latest"
        ) from error
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
