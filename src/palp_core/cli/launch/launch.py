"""``palp launch``."""

from __future__ import annotations

import contextlib
import faulthandler
import json
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from palp_core.cli import completion
from palp_core.cli.launch.remarks import note_remarks, note_without_effect
from palp_core.cli.launch.watched import go_on_watched
from palp_core.cli.options import Level
from palp_core.cli.output import note, print_text
from palp_core.counted import counted
from palp_core.errors import GraphError, NodeError, PalpError
from palp_core.graph.problems import hint
from palp_core.graph.supervision.logs import LogLevels
from palp_core.whole_file import write_whole

if TYPE_CHECKING:
    from palp_core.graph.launch.diagnostics import Incident
    from palp_core.graph.launch.graph import Graph
    from palp_core.graph.launch.summary import RunSummary
    from palp_core.graph.lockstep.digest import TopicDigest

RESUMES = "resume:=true"
"""The option, written like an argument of the launch file."""

LogLevelOption = Annotated[
    list[str] | None,
    typer.Option(
        "--log-level",
        metavar="[NODE:=]LEVEL",
        help="The least of what nodes, or one node, log that is shown here. Repeatable; default: warning.",
    ),
]


def launch(
    file: Annotated[Path, typer.Argument(help="Launch file.")],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[name:=value]...",
            help="Its arguments; NODE.PARAM:=VALUE and shared.PARAM:=VALUE too.",
            autocompletion=completion.launch_arguments,
        ),
    ] = None,
    *,
    check: Annotated[bool, typer.Option("--check", help="Check everything, start nothing.")] = False,
    name: Annotated[
        str | None,
        typer.Option("--name", metavar="NAME", help="What the running graph is called; default: as in FILE."),
    ] = None,
    log_level: LogLevelOption = None,
    compose: Annotated[bool, typer.Option("--compose", help="All nodes in this process.")] = False,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Record every topic into this bag.")
    ] = None,
    digest: Annotated[Path | None, typer.Option(help="Write a SHA-256 per topic to this JSON file.")] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Let nodes of other hosts join there.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser: palp view.")] = False,
    operate: Annotated[
        bool, typer.Option("--operate", help="With --view: let more be pressed than stop, on a rig too.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where this run was interrupted (or resume:=true).")
    ] = False,
    repeat: Annotated[
        int | None,
        typer.Option(
            "--repeat", metavar="N", help="N runs on all cores, seed by seed, each in a folder of its own."
        ),
    ] = None,
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
        from palp_core.graph.launch.graph import check_file, check_start

        checked = check_file(file, overrides)
        for words in check_start(file, checked, name, resume=resume):
            note(f"{file}: {words}")
        note_remarks(file, checked)
        print_text(
            f"{file}: no mistake: {counted(len(checked.nodes), 'node')}, "
            f"{counted(len(checked.topics), 'topic')}"
        )
        return
    if repeat is not None:
        from palp_core.cli.launch.repeat import refuse_options
        from palp_core.cli.launch.repeat import repeat as run_repeatedly

        refuse_options(
            {"--record": record, "--digest": digest, "--listen": listen, "--name": name, "--view": view}
        )
        sys.exit(run_repeatedly(file, overrides, repeat, compose=compose, resume=resume))
    announce_end = go_on_watched() if compose else lambda: None
    if compose:
        faulthandler.enable()  # a crash in C names its Python lines, as in nodes' processes
    status = _run(
        file, overrides, name=name, log_level=levels, compose=compose, digest=digest, record=record,
        listen=listen, in_browser=view, operate=operate, resume=resume,
    )  # fmt: skip
    announce_end()
    sys.exit(status)


def _run(
    file: Path,
    overrides: list[str],
    *,
    name: str | None,
    log_level: LogLevels,
    compose: bool,
    digest: Path | None,
    record: Path | None,
    listen: str | None,
    in_browser: bool,
    operate: bool,
    resume: bool,
) -> int:
    """Run a graph and say how it went; return the exit status."""
    from palp_core.graph.supervision.fork_start import start_fork_server

    if in_browser:
        from palp_core.cli.view.beside import check_can_show

        check_can_show()
    if digest is not None and resume:
        raise GraphError(
            "--digest with --resume: a digest is of a whole run, and this one is the rest of one"
        )
    if digest is not None:
        _check_writable(digest)
    started = start_fork_server()  # it warms up while this process imports what it needs
    from palp_core.cli.launch.stop_key import stop_key
    from palp_core.cli.launch.view import LaunchView, show_log_line
    from palp_core.graph.launch.graph import Graph
    from palp_core.graph.lockstep.digest import TopicDigest
    from palp_core.graph.messages.builtin import Progress
    from palp_core.graph.supervision.interrupt import Interrupted

    view = LaunchView()
    of_topics = None if digest is None else TopicDigest()
    graph = Graph(
        file,
        compose=compose,
        observe=of_topics,
        overrides=overrides,
        started=started,
        listen=listen,
        record=record,
        name=name,
        resume=resume,
        log_level=log_level,
        show_log=show_log_line,
    )
    graph.observers.add(Progress, view.show_progress)
    graph.diagnostics.on_change = lambda topic, incident: view.show_diagnostic(
        topic, _addressed(graph, incident)
    )
    try:
        with _recorders_said(graph), graph:
            _check_levels(log_level, [spec.name for spec in graph.checked.nodes])
            _say_beside(graph)
            note_without_effect(file, graph.checked)
            if graph.gateway is not None:
                graph.gateway.announce_to(note)
            with (
                _shown(graph, wanted=in_browser, operate=operate),
                _written(digest, of_topics),
                view.showing(graph.checked),
                stop_key(graph),
            ):
                summary = graph.run()
    except Interrupted as stop:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks once more does not change how it ended
        note(f"{stop}; every node has ended")
        _say_report(graph)
        return 128 + int(stop.signal)
    except NodeError as error:
        note(str(error))
        _say_report(graph)
        return 1
    except PalpError as error:
        note(str(error))
        _say_report(graph)
        return 2
    _print_summary(summary)
    _say_incidents(graph)
    if not graph.recorders.complete:
        return 1
    return summary.exit_code if 0 <= summary.exit_code < 256 else 1


def log_levels(words: Sequence[str] | None) -> LogLevels:
    """Return the level of all nodes, and of those that have their own.

    Raises:
        GraphError: A level that there is not.

    >>> log_levels(["error", "policy:=debug"])
    LogLevels(default='error', nodes={'policy': 'debug'})
    """
    default, nodes = "warning", dict[str, str]()
    for word in words or ():
        node, own, level = word.rpartition(":=")
        if level.lower() not in get_args(Level):
            raise GraphError(f"--log-level {word}: no level '{level}'{hint(level, get_args(Level))}")
        if own:
            nodes[node.removeprefix("/")] = level.lower()
        else:
            default = level.lower()
    return LogLevels(default, nodes)


def _check_levels(levels: LogLevels, known: Sequence[str]) -> None:
    """See that the nodes that have a level of their own are there.

    Raises:
        GraphError: One is not.
    """
    for node in levels.nodes:
        if node not in known:
            raise GraphError(f"--log-level {node}:=...: no node '{node}'{hint(node, known)}")


def _addressed(graph: Graph, incident: Incident | None) -> Incident | None:
    """Return what is wrong with advice that names this run, if it is not the only one."""
    import msgspec

    from palp_core.graph.discovery.choice import addressed

    if incident is None:
        return None
    return msgspec.structs.replace(incident, advice=addressed(incident.advice, graph.directory.path.name))


def _say_incidents(graph: Graph) -> None:
    """Say at the very end what nodes said was wrong, a trip of a safety node above all."""
    sys.stdout.flush()
    for incident in graph.diagnostics.incidents:
        note(str(incident))


def _say_beside(graph: Graph) -> None:
    """Say which run this is if it is not the only one."""
    from palp_core.graph.discovery.run_directory import running

    if len(running()) > 1:
        note(f"graph '{graph.checked.graph}', id {graph.directory.path.name}, beside others: palp graph list")


def _check_writable(digest: Path) -> None:
    """Find out now, rather than after hours, whether the digest can be written."""
    try:
        digest.touch()
    except OSError as error:
        raise GraphError(f"--digest {digest}: cannot be written: {error.strerror}") from error


def _shown(graph: Graph, *, wanted: bool, operate: bool) -> contextlib.AbstractContextManager[None]:
    """Show a graph in the browser for as long as it runs, if that is wanted."""
    if not wanted:
        return contextlib.nullcontext()
    from palp_core.cli.view.beside import shown_beside

    return shown_beside(graph.directory.path.name, operate=operate)


@contextlib.contextmanager
def _written(file: Path | None, digest: TopicDigest | None) -> Iterator[None]:
    """Write the digest, if there is one, however the run ends."""
    try:
        yield
    finally:
        if file is not None and digest is not None:
            write_whole(file, json.dumps(digest.result(), indent=1) + "\n")


@contextlib.contextmanager
def _recorders_said(graph: Graph) -> Iterator[None]:
    """Say what became of a graph's recordings, however it ends."""
    try:
        yield
    finally:
        if graph.recorders.text:
            print_text(graph.recorders.text)


def _say_report(graph: Graph) -> None:
    if graph.summary is not None and graph.summary.report:
        print_text(graph.summary.report)
    _say_incidents(graph)
    if graph.summary is not None and (command := graph.checkpoints.command(graph.path)):
        note(f"to go on where it was: {command}")


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
