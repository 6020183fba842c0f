"""``palp launch``."""

from __future__ import annotations

import faulthandler
import json
import signal
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from palp_core.cli import completion
from palp_core.cli.launch.graph import note_remarks, note_without_effect
from palp_core.cli.launch.watched import go_on_watched
from palp_core.cli.options import Level, argument, option
from palp_core.cli.output import note, print_text
from palp_core.counted import counted
from palp_core.errors import GraphError, NodeError, PalpError
from palp_core.graph.problems import hint
from palp_core.graph.supervision.logs import LogLevels
from palp_core.whole_file import write_whole

if TYPE_CHECKING:
    from palp_core.graph.launch.graph import Graph
    from palp_core.graph.launch.run_journal import Incident
    from palp_core.graph.launch.summary import RunSummary
    from palp_core.graph.lockstep.digest import TopicDigest

RESUMES = "resume:=true"
"""The option, written like an argument of the launch file."""

LogLevelOption = Annotated[
    list[str] | None,
    option("Least level shown, of a node or all; default: warning.", "--log-level", metavar="[NODE:=]LEVEL"),
]


def launch(
    file: Annotated[Path, argument("Launch file.")],
    arguments: Annotated[
        list[str] | None,
        argument(
            "Its arguments, and NODE.PARAM:=VALUE, shared.PARAM:=VALUE.",
            "[name:=value]...",
            complete=completion.launch_arguments,
        ),
    ] = None,
    *,
    check: Annotated[bool, option("Check everything, start nothing.", "--check")] = False,
    name: Annotated[
        str | None, option("What the running graph is called; default: as in FILE.", metavar="NAME")
    ] = None,
    log_level: LogLevelOption = None,
    compose: Annotated[bool, option("All nodes in this process.", "--compose")] = False,
    record: Annotated[Path | None, option("Record every topic into this bag.", metavar="DIR")] = None,
    digest: Annotated[Path | None, option("Write a SHA-256 per topic to this JSON file.")] = None,
    listen: Annotated[
        str | None, option("Let nodes of other hosts join there.", metavar="tcp://HOST:PORT")
    ] = None,
    view: Annotated[bool, option("Show it in the browser: palp view.", "--view")] = False,
    operate: Annotated[
        bool, option("With --view: let more be pressed than stop, on a rig too.", "--operate")
    ] = False,
    resume: Annotated[
        bool, option("Go on where this run was interrupted (or resume:=true).", "--resume")
    ] = False,
) -> None:
    """The exit status is the run's: 0 if it came to its end, 1 if a node failed or the report did, 2 if the
    launch file has mistakes, 130 on Ctrl-C.
    """
    overrides = [word for word in arguments or [] if word != RESUMES]
    levels = log_levels(log_level)
    resume = resume or RESUMES in (arguments or [])
    if operate and not view:
        raise GraphError("--operate lets a page be pressed that --view shows: give both")
    if check:
        from palp_core.graph.launch.checking import check_file, check_start

        checked = check_file(file, overrides)
        for text in check_start(file, checked, name, resume=resume):
            note(f"{file}: {text}")
        note_remarks(file, checked)
        print_text(
            f"{file}: no mistake: {counted(len(checked.nodes), 'node')}, "
            f"{counted(len(checked.topics), 'topic')}"
        )
        return
    announce_end = go_on_watched() if compose else lambda: None
    if compose:
        faulthandler.enable()  # a crash in C names its Python lines, as in nodes' processes
    options: dict[str, Any] = {"overrides": overrides, "name": name, "log_level": levels, "compose": compose}
    options |= {"record": record, "listen": listen, "resume": resume}
    status = _run(file, digest, in_browser=view, operate=operate, **options)
    announce_end()
    sys.exit(status)


def _run(file: Path, digest: Path | None, *, in_browser: bool, operate: bool, **options: Any) -> int:
    """Run a graph with options of :class:`Graph`; print how it went, and return the exit status."""
    from palp_core.graph.supervision.fork_start import start_fork_server

    if in_browser:
        from palp_core.view.server.serve import check_installed

        check_installed()
    if digest is not None and options["resume"]:
        raise GraphError("--digest with --resume: a digest is of a whole run; leave out one of them")
    if digest is not None:
        try:
            digest.touch()  # now, rather than after hours
        except OSError as error:
            raise GraphError(f"--digest {digest}: cannot be written: {error.strerror}") from error
    started = start_fork_server()  # it warms up while this process imports what it needs
    from palp_core.cli.launch.stop_key import stop_key
    from palp_core.cli.launch.view import LaunchView, show_log_line
    from palp_core.cli.view import shown_by_viewer
    from palp_core.graph.discovery.run_directory import running
    from palp_core.graph.launch.graph import Graph
    from palp_core.graph.lockstep.digest import TopicDigest
    from palp_core.graph.messages.builtin import Progress
    from palp_core.graph.supervision.interrupt import Interrupted

    view = LaunchView()
    of_topics = None if digest is None else TopicDigest()
    graph = Graph(file, observe=of_topics, started=started, show_log=show_log_line, **options)
    graph.observers.add(Progress, view.show_progress)
    graph.journal.on_incident = lambda topic, found: view.show_diagnostic(topic, _addressed(graph, found))
    try:
        with ExitStack() as ending:
            ending.callback(_print_recordings, graph)
            ending.enter_context(graph)
            _check_levels(options["log_level"], [spec.name for spec in graph.checked.nodes])
            if len(running()) > 1:
                run = graph.directory.path.name
                note(f"graph '{graph.checked.graph}', id {run} runs next to others: palp graph list")
            note_without_effect(file, graph.checked)
            if graph.gateway is not None:
                graph.gateway.announce_to(note)
            if in_browser:
                ending.enter_context(shown_by_viewer(graph.directory.path.name, operate=operate))
            if digest is not None and of_topics is not None:
                ending.callback(_write_digest, digest, of_topics)
            with view.showing(graph.checked), stop_key(graph):
                summary = graph.run()
    except Interrupted as stop:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # once more does not change how it ended
        note(f"{stop}; all nodes exited")
        _print_report(graph)
        return 128 + int(stop.signal)
    except PalpError as error:
        note(str(error))
        _print_report(graph)
        return 1 if isinstance(error, NodeError) else 2
    _print_summary(summary)
    _note_incidents(graph)
    if not graph.recorders.complete:
        return 1
    return summary.exit_code if 0 <= summary.exit_code < 256 else 1


def log_levels(texts: Sequence[str] | None) -> LogLevels:
    """Return the level of all nodes, and of those that have their own.

    >>> log_levels(["error", "policy:=debug"])
    LogLevels(default='error', nodes={'policy': 'debug'})
    """
    default, nodes = "warning", dict[str, str]()
    for word in texts or ():
        node, own, level = word.rpartition(":=")
        if level.lower() not in get_args(Level):
            raise GraphError(f"--log-level {word}: no level '{level}'{hint(level, get_args(Level))}")
        if own:
            nodes[node.removeprefix("/")] = level.lower()
        else:
            default = level.lower()
    return LogLevels(default, nodes)


def _check_levels(levels: LogLevels, known: Sequence[str]) -> None:
    for node in levels.nodes:
        if node not in known:
            raise GraphError(f"--log-level {node}:=...: no node '{node}'{hint(node, known)}")


def _addressed(graph: Graph, incident: Incident | None) -> Incident | None:
    """Return what is wrong with advice that names this run, if it is not the only one."""
    import msgspec

    from palp_core.graph.discovery.choice import addressed_advice

    if incident is None:
        return None
    advice = addressed_advice(incident.advice, graph.directory.path.name)
    return msgspec.structs.replace(incident, advice=advice)


def _note_incidents(graph: Graph) -> None:
    """Note at the very end what nodes reported, a trip of a safety node above all."""
    sys.stdout.flush()
    for incident in graph.journal.entries.incidents:
        note(str(incident))


def _write_digest(file: Path, digest: TopicDigest) -> None:
    write_whole(file, json.dumps(digest.result(), indent=1) + "\n")


def _print_recordings(graph: Graph) -> None:
    if graph.recorders.text:
        print_text(graph.recorders.text)


def _print_report(graph: Graph) -> None:
    if graph.summary is not None and graph.summary.report:
        print_text(graph.summary.report)
    _note_incidents(graph)
    if graph.summary is not None and (command := graph.checkpoints.command(graph.path)):
        note(f"to resume: {command}")


def _print_summary(summary: RunSummary) -> None:
    pace = (
        f"{summary.clock_s / summary.wall_s:.0f} times real time" if summary.clock == "sim" else "real time"
    )
    print_text(
        f"{summary.graph} ended after {summary.clock_s:.1f} s on its clock, "
        f"{summary.wall_s:.1f} s of wall time ({pace})"
    )
    if summary.report:
        print_text(summary.report)
