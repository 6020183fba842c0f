"""The server as it is started: one process over a bag, attacked over its socket."""

from __future__ import annotations

import importlib.util
import logging
import os
import queue
import signal
import sys
import webbrowser
from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.cli.view import _opened
from palp_core.extras import install_line
from palp_core.view.server.serve import IdleTimer
from palp_core.view.server.stderr import MOST_CHARACTERS, NonBlockingStderr, nonblocking_stderr
from tests.support.bags import record, run_frames
from tests.support.palp import CHAIN, PATIENCE_S, Palp, wait_for_line
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer

pytest.importorskip("nicegui")
IDLE_SOCKETS = 100


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("bag") / "run", run_frames(20))[0]


@pytest.fixture(scope="module")
def server(shared_palp: Palp, bag: Path) -> PageServer:
    return PageServer(address_of(shared_palp.start("view", bag, "--no-browser")))


def test_the_printed_address_leads_to_the_page(server: PageServer) -> None:
    moved = server.ask(f"/?token={server.token}")
    assert (moved.status, moved.headers["location"]) == (303, f"/{server.token}/")
    page = server.ask(f"/{server.token}/")
    assert page.status == 200
    assert b"<title>run - palp view</title>" in page.body
    assert "default-src 'self'" in page.headers["content-security-policy"]
    assert f"/{server.token}/_nicegui".encode() in page.body  # its own files need the token, too


def test_the_gate_is_in_front(server: PageServer) -> None:
    for path in ("/", "/_nicegui/static/nicegui.js", "/docs", "/openapi.json", "/wrong/"):
        assert server.ask(path).status == 403
    assert server.ask(f"/{server.token}/", Host="rig.example:80").status == 421
    assert server.ask(f"/{server.token}/", Origin="http://evil.example").status == 403


def test_a_hundred_silent_sockets_and_a_flood_keep_no_browser_out(server: PageServer) -> None:
    idle = [server.connect() for _ in range(IDLE_SOCKETS)]
    flood = server.connect()
    try:
        flood.sendall(b"GET / HTTP/1.1\r\n")
        for _ in range(64):
            flood.sendall(b"X: " + b"x" * 4096 + b"\r\n")
    except OSError:
        pass  # it has been hung up on, which is as well
    status = server.ask(f"/{server.token}/").status
    for one in (*idle, flood):
        one.close()
    assert status == 200


@pytest.mark.parametrize("words", [("view",), ("launch", CHAIN, "--view")])
def test_without_the_extra_a_line_says_what_to_install(
    words: tuple[object, ...], palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = importlib.util.find_spec
    hide = lambda name, *rest: None if name == "nicegui" else known(name, *rest)  # noqa: E731
    monkeypatch.setattr(importlib.util, "find_spec", hide)
    done = palp.refused(*words)
    assert done == f"palp view needs NiceGUI, which is not installed; type: {install_line('view')}\n"


def test_what_cannot_be_shown_is_refused(palp: Palp, server: PageServer, bag: Path, tmp_path: Path) -> None:
    for words, why in (
        ((tmp_path / "none",), "no such"),
        ((tmp_path,), "open report.html"),
        ((bag, "--port", server.port), f"--port {server.port}: Address already in use"),
        ((), "to look around: palp launch rig:sim.yaml trials:=100000 --view\n"),
    ):
        done = palp.here("view", *words, "--no-browser")
        assert (done.returncode, why in done.stderr) == (2, True), done.stderr


@pytest.mark.parametrize(
    ("ended_by", "status"),
    [pytest.param(signal.SIGINT, 130, marks=pytest.mark.nightly), (signal.SIGKILL, -signal.SIGKILL)],
)
def test_a_launch_with_view_shows_the_graph_and_its_viewer_ends_with_it(
    ended_by: signal.Signals, status: int, palp: Palp
) -> None:
    palp.environment["BROWSER"] = "true"
    process = palp.start("launch", CHAIN, "--view", "--operate", "count:=100000")
    wait_for_line(process, "http://127.0.0.1:")
    assert any("--operate" in viewer.cmdline() for viewer in palp.running("--graph"))
    process.send_signal(ended_by)
    assert process.wait(PATIENCE_S) == status
    assert palp.all_gone()


def test_the_browser_is_given_a_file_of_ones_own_and_no_token_in_its_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: queue.Queue[str] = queue.Queue()
    monkeypatch.setattr(webbrowser, "open", opened.put)
    where = "http://127.0.0.1:1/?token=secret"
    with _opened(where):
        words = opened.get(timeout=PATIENCE_S)
        page = Path(words.removeprefix("file://"))
        assert "secret" not in words
        assert where in page.read_text(encoding="utf-8")
        assert (page.stat().st_mode & 0o077, page.parent.stat().st_mode & 0o077) == (0, 0)
    assert not page.exists()


def test_a_viewer_is_idle_when_it_was_out_of_use_for_long_enough() -> None:
    timer = IdleTimer(60.0)
    looks = [(0, True), (100, True), (400, False), (459, False), (459, True), (470, False), (529, False)]
    assert not any(timer.expired(at_s * 10**9, in_use=in_use) for at_s, in_use in looks)
    assert timer.expired(530 * 10**9, in_use=False)


def test_a_viewer_ends_after_its_graph_when_no_one_looks(palp: Palp) -> None:
    graph = palp.start("launch", CHAIN, "count:=1000000")
    wait_for_line(graph, "blocks: 1/")
    palp.constants["palp_core.view.server.serve:IDLE_S"] = 0.0
    palp.constants["palp_core.view.server.serve:LOOK_S"] = 0.05
    viewer = palp.start("view", "--no-browser")
    wait_for_line(viewer, "http://")
    assert palp.run("graph", "end").returncode == 0
    _, errors = viewer.communicate(timeout=PATIENCE_S)
    assert viewer.returncode == 0, errors
    assert "has ended and no browser is open: closing" in errors
    graph.communicate(timeout=PATIENCE_S)


LINE = "x" * 99 + "\n"
MANY = 20_000
"""Lines: 2 MB, far more than a pipe takes."""


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


@pytest.mark.parametrize("length", [len(LINE), 2**17])
def test_a_writer_does_not_wait_for_a_pipe_that_is_not_read(length: int, pipe: tuple[int, int]) -> None:
    stream = NonBlockingStderr(pipe[1])
    for _ in range(10):  # of one that was full for a while
        stream._taken_count = 0
        for _ in range(MANY // 10):
            stream.write("x" * length)
    assert stream._left_out > 0


def test_what_is_too_much_is_left_out_and_counted(pipe: tuple[int, int]) -> None:
    stream = NonBlockingStderr(pipe[1])
    printed = b""
    for _ in range(MANY):
        stream.write(LINE)
        if len(printed) < MOST_CHARACTERS // len(LINE) * len(LINE):
            printed += os.read(pipe[0], 1 << 16)
    assert printed == LINE.encode() * (MOST_CHARACTERS // len(LINE))
    stream._begun_ns -= round(3600e9)  # an hour later
    stream.write("the last\n")
    assert os.read(pipe[0], 1 << 16).decode().splitlines() == [
        f"palp view: {MANY - MOST_CHARACTERS // len(LINE)} more texts were not printed",
        "the last",
    ]


def test_what_libraries_log_goes_the_same_way(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    with os.fdopen(os.dup(pipe[1]), "w") as before, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", before)
        with nonblocking_stderr():
            log = logging.Logger("a library")
            log.addHandler(logging.StreamHandler())
            log.warning("a word")
        assert sys.stderr is before
        assert os.read(pipe[0], 100) == b"a word\n"
