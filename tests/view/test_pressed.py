"""The pages of a running graph over their socket: what is pressed is done, and no attack gets what it wants.

An attack is a function that fails if it got what it wanted. Those that take long are nightly.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import socket
import subprocess
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import psutil
import pytest
from websockets.exceptions import ConnectionClosed

from palp_core.graph.swap.swap import STEPS
from tests.support.palp import PATIENCE_S
from tests.support.talkative import Talk, talk
from tests.support.view.accounts import Accounts
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer, PageSocket

pytest.importorskip("nicegui")
__all__ = ["talk"]

EVIL = "http://evil.example"
OTHERS = """
from nodes.talk import Scale


class Calm(Scale):
    pass


class Quiet(Scale):
    pass
"""


class Target(msgspec.Struct):
    """The graph, a page on which everything may be pressed, and one that is read-only."""

    talk: Talk
    open: PageServer
    closed: PageServer
    accounts: Accounts
    process: int

    def value(self, name: str) -> object:
        """A parameter of the source, as the graph has it."""
        return self.accounts.graph.ask("source", "get_parameters")["parameters"][name]

    def page(self, path: str = "/") -> str:
        return f"/{self.open.token}{path}"


def view(talk: Talk, *arguments: str) -> subprocess.Popen[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(talk.folder)  # bags are made where it was started
        return talk.palp.start("view", "--no-browser", "--graph", "talk", *arguments)


@pytest.fixture(scope="module")
def target(talk: Talk) -> Target:
    (talk.folder / "nodes/others.py").write_text(OTHERS, encoding="utf-8")
    shown, closed = view(talk), view(talk, "--read-only")
    first, second = PageServer(address_of(shown)), PageServer(address_of(closed))
    for process in (shown, closed):  # what they say of nonsense is more than a pipe holds
        assert process.stderr is not None
        threading.Thread(target=process.stderr.read, daemon=True).start()
    return Target(talk, first, second, Accounts(talk.palp, "talk", "scale", "/source/sample"), shown.pid)


def statuses(data: bytes) -> list[int]:
    """Return the statuses of all answers in what a server has sent."""
    return [int(line.split()[1]) for line in data.split(b"\r\n") if line.startswith(b"HTTP/1.1 ")]


# By the door; what has no token or comes from elsewhere: tests/view/test_gate.py and test_server.py


def a_post_of_another_site(target: Target) -> None:
    polling = f"{target.page('/_nicegui_ws/socket.io/')}?EIO=4&transport=polling"
    text = b'42["event",{}]'
    assert target.open.ask(polling, "POST", text, Origin=EVIL, Content_Type="text/plain").status == 403
    assert target.open.ask(polling, "POST", text, Sec_Fetch_Site="cross-site").status == 403
    assert target.open.ask(polling, Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="no-cors").status == 403
    for method in ("PUT", "DELETE", "PATCH", "TRACE"):
        assert target.open.ask(target.page("/node/source"), method, b"rate_hz=1").status in (404, 405)
    for button in ("stop", "acknowledge", "x"):
        assert target.open.ask(target.page(f"/press/{button}"), "POST", b"", Origin=EVIL).status == 403
        assert target.open.ask(f"/press/{button}", "POST", b"", Origin=target.open.origin).status == 403
        assert target.open.ask(target.page(f"/press/{button}")).status in (404, 405)
    preflight = target.open.ask(polling, "OPTIONS", Origin=EVIL, Access_Control_Request_Method="POST")
    assert preflight.status == 403
    assert preflight.headers.get("access-control-allow-origin") is None
    for method in ("GET", "POST"):  # the gate counts sockets: no one polls, whatever the origin
        assert target.open.ask(polling, method, b"40", Origin=target.open.origin).status == 400


# What no browser would send


def smuggled_requests(target: Target) -> None:
    """Requests that two servers would divide differently: a second one in the body of the first."""
    host = target.open.host.encode()
    hidden = b"GET /nothing HTTP/1.1\r\nHost: %b\r\n\r\n" % host
    lengths = (
        b"Content-Length: 0\r\nTransfer-Encoding: chunked",
        b"Content-Length: 0\r\nContent-Length: %d" % len(hidden),
        b"Transfer-Encoding: xchunked",
        b"Transfer-Encoding : chunked",
        b"Content-Length: +0",
        b"X: a\r\n Content-Length: 0",
    )
    for words in lengths:
        head = b"GET / HTTP/1.1\r\nHost: %b\r\nConnection: close\r\n%b\r\n\r\n" % (host, words)
        found = target.open.raw(head + b"0\r\n\r\n" + hidden)
        assert found == b"" or all(status >= 400 for status in statuses(found)), words
    elsewhere = b"GET http://evil.example%b HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
    assert statuses(target.open.raw(elsewhere % target.page().encode())) == [421]
    twice = b"GET %b HTTP/1.1\r\nHost: %b\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
    assert statuses(target.open.raw(twice % (target.page().encode(), host)))[0] >= 400


def paths_out_of_the_page(target: Target) -> None:
    page = target.open.ask(target.page()).body.decode()
    version = page.split("/_nicegui/")[1].split("/")[0]
    for place in ("static", "resources/x", "components", "esm/nicegui-echart", "libraries"):
        for way in ("../" * 9, "..%2f" * 9, "%2e%2e/" * 9, "..%5c" * 9, "/", "%2f"):
            for file in ("etc/passwd", "proc/self/environ"):
                answer = target.open.ask(target.page(f"/_nicegui/{version}/{place}/{way}{file}"))
                assert answer.status in (403, 404, 405), (place, way)
                assert b"root:" not in answer.body
    for path in ("/docs", "/openapi.json", "/redoc", "/files/x", "/_nicegui/auto/static/x"):
        assert target.open.ask(target.page(path)).status == 404


def the_token_leads_nowhere(target: Target) -> None:
    headers = target.open.ask(target.page("/topics")).headers
    assert (headers["referrer-policy"], "no-store" in headers["cache-control"]) == ("no-referrer", True)
    injected = target.open.ask(f"/?token={target.open.token}%0d%0aSet-Cookie:%20a=b")
    assert (injected.status >= 400, "set-cookie" in injected.headers) == (True, False)
    assert target.open.ask("/", Referer=f"{target.open.origin}{target.page()}").status == 403
    log = "".join(
        path.read_text(encoding="utf-8", errors="replace")
        for path in target.accounts.graph.folder.rglob("*.log")
    )
    assert target.open.token not in log
    assert target.open.token not in " ".join(Path(f"/proc/{target.process}/cmdline").read_text().split("\0"))


# With the token: what a page would not say


def hung_up(page: PageSocket) -> None:
    """Wait until the server parts from a page."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            page.connection.recv(PATIENCE_S)


def what_a_read_only_page_hides(target: Target) -> None:
    swaps = target.accounts.swaps()
    page = PageSocket(target.closed, "/node/source")
    page.fill("rate_hz", "1")
    page.click("set rate_hz")
    page.says("this page is read-only")
    page.click("deactivate")
    page.click("restart")
    page.close()
    swap = PageSocket(target.closed, "/node/scale")
    swap.fill("class", "nodes.talk:Source")
    swap.click("swap")
    swap.says("this page is read-only")
    swap.close()
    assert target.value("rate_hz") == 100.0
    assert target.accounts.graph.ask("source", "info")["lifecycle"] == "active"
    assert target.accounts.swaps() == swaps


def values_out_of_their_bounds(target: Target) -> None:
    page = PageSocket(target.open, "/node/source")
    bombs = "{a: &a [x,x,x,x,x,x,x,x,x], b: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a], c: [*b,*b,*b,*b,*b,*b,*b,*b,*b]}"
    code = "!!python/object/apply:os.system ['true']"
    wrong = ("-3", ".nan", ".inf", "1e400", "0", code, "[1]", bombs, "[" * 5000)
    for value in (*wrong, "x" * 100_000):
        page.fill("rate_hz", value)
        page.click("set rate_hz")
    strange: list[Any] = [None, 5, {"a": 1}, [[]], True]
    for other in strange:
        page.fill("rate_hz", other)
    set_name(target, page, "set")
    page.close()
    assert target.value("rate_hz") == 100.0


def set_name(target: Target, page: PageSocket, name: str) -> None:
    """Do what one may do, and wait until it is done: all that was sent before has arrived."""
    page.fill("name", name)
    page.click("set name")
    while target.value("name") != name:
        page.read()


def events_without_a_page(target: Target) -> None:
    page, other = PageSocket(target.open, "/node/source"), PageSocket(target.open, "/node/source")
    found = page.labelled("set rate_hz")
    strange: list[Any] = [None, 5, "x", [], {}, {"client_id": "x"}, {"client_id": None}, {"client_id": []}]
    strange += [{"id": 10**9, "client_id": "x", "listener_id": "x", "args": []}]
    for data in strange:
        for name in ("event", "handshake", "javascript_response", "ack", "log", "disconnect", "none"):
            other.emit(name, data)
    page.event((found[0], {"events": [{"type": "click", "listener_id": "none"}]}), "click", {})
    set_name(target, page, "block")
    page.close()
    with contextlib.suppress(ConnectionClosed):
        other.close()


def words_that_are_no_words(target: Target) -> None:
    deep = "42" + json.dumps(["event"])[:-1] + "," + "[" * 100_000
    for text in ("42[", "42{}", "9", "", "4", "451-[", "42" + "9" * 1000, deep, b"\0\xff", "1", "41", "5"):
        page = PageSocket(target.open)
        with contextlib.suppress(ConnectionClosed):
            page.connection.send(text)
            page.connection.send('42["log",{}]')
        page.connection.close()


def too_long_a_word(target: Target) -> None:
    page = PageSocket(target.open)
    with contextlib.suppress(ConnectionClosed):
        page.connection.send("42" + "x" * (2 << 20))
    hung_up(page)


# Many, slow, silent


def pages_without_a_reader(target: Target) -> None:
    """A browser that opens pages and takes nothing of what comes."""
    for _ in range(30):
        target.open.ask(target.page("/topic/source/sample"))
    slow = PageSocket(target.open, "/topic/source/sample")
    slow.connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    target.accounts.go_on()
    slow.connection.socket.close()


CHEAP: list[Callable[[Target], None]] = [
    a_post_of_another_site,
    smuggled_requests,
    the_token_leads_nowhere,
    what_a_read_only_page_hides,
    values_out_of_their_bounds,
    events_without_a_page,
    too_long_a_word,
]
LONG = [
    paths_out_of_the_page,
    words_that_are_no_words,
    pages_without_a_reader,
]


@pytest.mark.parametrize(
    "attack",
    [
        *(pytest.param(one, id=one.__name__) for one in CHEAP),
        *(pytest.param(one, id=one.__name__, marks=pytest.mark.nightly) for one in LONG),
    ],
)
def test_an_attack_gets_nothing_and_keeps_no_one_out(
    attack: Callable[[Target], None], target: Target
) -> None:
    attack(target)
    assert target.open.ask(target.page()).status == 200
    target.accounts.go_on()


@pytest.mark.nightly
def test_a_browser_that_answers_no_ping_is_let_go(target: Target) -> None:
    page = PageSocket(target.open, "/topic/source/sample")
    hung_up(page)  # reading all, but saying no pong


def swap(page: PageSocket, choice: object, **options: object) -> None:
    """Choose a class, and let it take over."""
    page.fill("time-out, s", PATIENCE_S)
    for label, value in options.items():
        page.fill(label.replace("_", " "), value)
    page.fill("class", choice)
    page.click("swap")


def test_a_message_is_published_into_an_external_port(target: Target) -> None:
    with closing(PageSocket(target.open, "/topic/scale/load")) as page:
        page.fill("message", "{load_n: 2.5, samples: [], note: from the page}")
        page.click("publish")
        page.says("published as number 1")
        page.fill("message", "{load_n: heavy, samples: []}")
        page.click("publish")
        page.says("load_n: expected a number")


def test_a_dry_run_and_a_shadow_say_what_would_be_and_change_nothing(target: Target) -> None:
    graph, before = target.accounts.graph, target.accounts.swaps()
    was = graph.ask("scale", "info")["run"]
    with closing(PageSocket(target.open, "/node/scale")) as page:
        swap(page, "nodes.others:Quiet", dry_run=True)
        page.says(f"nodes.others:Quiet could take over from {was}; nothing was changed")
        page.fill("shadow, s", 0.2)
        page.click("swap")
        page.says("messages of both compared")
    assert (graph.ask("scale", "info")["run"], target.accounts.swaps()) == (was, before)


def test_a_swap_for_which_the_host_has_no_room_is_refused_and_the_graph_goes_on(target: Target) -> None:
    forks = psutil.Process(target.accounts.graph.node("scale").pid).parent()
    assert forks is not None
    before = forks.rlimit(psutil.RLIMIT_NOFILE)
    taken = {int(one.name) for one in Path(f"/proc/{forks.pid}/fd").iterdir()}
    room = next(number for number in itertools.count() if number not in taken)
    with closing(PageSocket(target.open, "/node/scale")) as page:
        forks.rlimit(psutil.RLIMIT_NOFILE, (room, before[1]))
        swap(page, "nodes.others:Quiet", dry_run=True)
        page.says("could not be started: Too many open files; the old node continues")
        forks.rlimit(psutil.RLIMIT_NOFILE, before)
        page.click("swap")
        page.says("nodes.others:Quiet could take over")
    target.accounts.go_on()


def test_a_viewer_that_is_killed_takes_neither_swap_nor_another_viewer_along(target: Target) -> None:
    before, process = target.accounts.swaps(), view(target.talk)
    other = PageServer(address_of(process))
    assert other.port != target.open.port
    with closing(PageSocket(other, "/node/scale")) as page:
        page.fill("shadow, s", 0.5)
        swap(page, "nodes.others:Calm")
        page.until(lambda one: one.get("text") in STEPS and "pill" in one.get("class", ()))
        process.kill()
        process.wait(PATIENCE_S)
    with closing(PageSocket(target.open, "/node/scale")) as page:
        page.says("nodes.others:Calm, process ")
    target.accounts.go_on()
    *earlier, last = target.accounts.swaps()
    assert (earlier, last.partition(":")[0]) == (before, "swapped")
