"""``palp view``: the live page of a graph in the browser, or the same page over a recording."""

from __future__ import annotations

import contextlib
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from palp_core.cli.options import GraphOption, argument, option
from palp_core.cli.output import note
from palp_core.cli.running import find_graph
from palp_core.errors import BagError, GraphError
from palp_core.graph.supervision.fork_child import die_with_parent

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator
    from types import ModuleType

    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.view.pages.viewer import OwnPage
    from palp_core.view.source.recorded import RecordedSource


END_S = 5.0
OF_PALP = "palp_core."
"""A bag may come from anybody: no page that it names is loaded but palp's own."""
TRY = "palp launch rig:sim.yaml trials:=100000 --view"


def view(
    what: Annotated[Path | None, argument("A bag; default: the running graph.", "[BAG]")] = None,
    *,
    port: Annotated[int, option("Port on this host; 0: any free port.", min=0, max=65535)] = 0,
    no_browser: Annotated[bool, option("Only print the address.", "--no-browser")] = False,
    read_only: Annotated[bool, option("Disable all controls.", "--read-only")] = False,
    operate: Annotated[
        bool, option("On a real rig, enable all controls, not only stop.", "--operate")
    ] = False,
    graph: GraphOption = None,
) -> None:
    """Only this host can connect, with the printed address. From another host, first run
    ssh -L PORT:127.0.0.1:PORT HOST.
    """
    from palp_core.graph.local_access import new_token
    from palp_core.view.server.serve import address, check_installed, listening_socket

    check_installed()
    running = _running(graph) if what is None else None
    source = None if what is None else _over(what)
    listening, token = listening_socket(port), new_token()
    where = address(listening, token)
    sys.stdout.write(f"{where}\n")
    sys.stdout.flush()
    try:
        with contextlib.nullcontext() if no_browser else _opened(where):
            if source is not None:
                _show_over(listening, token, source)
            elif running is not None:
                _show_live(listening, token, running, read_only=read_only, operate=operate)
    except KeyboardInterrupt:
        note("the page is closed" + ("; the graph goes on" if running is not None else ""))


def _running(name: str | None) -> RunningGraph:
    """Return the graph to show; without one, name a launch to look at."""
    from palp_core.graph.discovery.choice import WhichGraph

    try:
        return find_graph(name)
    except WhichGraph:
        raise
    except GraphError as error:
        if name is not None:
            raise
        raise GraphError(f"{error}; to look around: {TRY}") from error


def _over(what: Path) -> RecordedSource:
    from palp_core.graph.bag.metadata import in_order
    from palp_core.view.source.recorded import RecordedSource

    if what.is_dir() and not in_order(what):
        raise BagError(f"{what}: no bag; give a bag, or open report.html of a run's folder in a browser")
    return RecordedSource(what)


def _show_over(listening: socket.socket, token: str, bag: RecordedSource) -> None:
    from palp_core.view.pages.routes import register_pages
    from palp_core.view.pages.viewer import Viewer
    from palp_core.view.server.serve import serve

    named = str(bag.launch().get("view", ""))
    own = _own_page(named, importlib.import_module) if named.startswith(OF_PALP) else None
    own = own if own is not None and own.over_bags else None
    try:
        serve(listening, token, lambda: register_pages(Viewer(source=bag, own_page=own, time=bag)))
    finally:
        bag.close()


def _show_live(
    listening: socket.socket, token: str, running: RunningGraph, *, read_only: bool, operate: bool
) -> None:
    from palp_core.graph.node.loading import load_module
    from palp_core.view.pages.routes import register_pages
    from palp_core.view.pages.viewer import Viewer
    from palp_core.view.server.serve import serve
    from palp_core.view.source.live import LiveSource
    from palp_core.view.source.operator import GraphOperator

    own = _own_page(running.record.view, lambda module: load_module(module, running.record.workspace))
    source = LiveSource(running)
    operator = GraphOperator(source, read_only=read_only, operate=operate)
    viewer = Viewer(source=source, operator=operator, own_page=own)
    try:
        pages = lambda: register_pages(viewer)  # noqa: E731
        simulated = running.record.clock == "sim"
        serve(listening, token, pages, low_priority=simulated, over=lambda: not running.alive)
        note(f"graph '{running.record.graph}' has ended and no browser is open: closing")
    finally:
        source.close()


def _own_page(named: str, load: Callable[[str], ModuleType]) -> OwnPage | None:
    """Return the launch file's own page; one that cannot be loaded is noted, and left out."""
    from palp_core.errors import in_words
    from palp_core.view.pages.viewer import OwnPage

    module, _, name = named.partition(":")
    if not name:
        return None
    try:
        return OwnPage(getattr(load(module), name))
    except Exception as error:  # noqa: BLE001 - a module of your own may raise anything
        note(f"view: {named}: {in_words(error)}; the other pages are there")
        return None


@contextlib.contextmanager
def _opened(where: str) -> Iterator[None]:
    """Open the user's browser; one that cannot be opened is no failure: the address is printed.

    The browser is given a file of the user's own that leads there: a list of processes shows no token.
    """
    import tempfile
    import threading
    import webbrowser

    with tempfile.TemporaryDirectory(prefix="palp-view-") as folder:
        page = Path(folder) / "open.html"
        page.touch(mode=0o600)
        page.write_text(f'<meta http-equiv="refresh" content="0; url={where}">\n', encoding="utf-8")
        threading.Thread(target=webbrowser.open, args=(page.as_uri(),), daemon=True).start()
        yield


@contextlib.contextmanager
def shown_by_viewer(run: str, *, operate: bool) -> Iterator[None]:
    """Show a running graph in the browser; the viewer ends with it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "palp_core", "view", "--graph", run, *(["--operate"] if operate else [])],
        stdin=subprocess.DEVNULL,
        env={**os.environ, "PYTHONHASHSEED": "random"},
        start_new_session=True,  # Ctrl-C is the launcher's
        preexec_fn=partial(die_with_parent, os.getpid()),  # and if that is killed, it goes, too
    )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
