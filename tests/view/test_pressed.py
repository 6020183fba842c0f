"""What is pressed on the pages of a running graph is done: over their socket, without a browser."""

from __future__ import annotations

import itertools
import subprocess
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from palp_core.graph.swap.swap import STEPS
from tests.support.palp import PATIENCE_S, Palp
from tests.support.talkative import Talk, talk
from tests.support.view.accounts import Accounts
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer, PageSocket

pytest.importorskip("nicegui")
__all__ = ["talk"]

OTHERS = """
from nodes.talk import Scale


class Calm(Scale):
    pass


class Quiet(Scale):
    pass
"""


@pytest.fixture(scope="module")
def server(talk: Talk, shared_palp: Palp) -> PageServer:
    (talk.folder / "nodes/others.py").write_text(OTHERS, encoding="utf-8")
    return PageServer(address_of(view(talk, shared_palp)))


def view(talk: Talk, palp: Palp) -> subprocess.Popen[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(talk.folder)  # bags are made where it was started
        return palp.start("view", "--no-browser", "--graph", "talk")


def swap(page: PageSocket, choice: object, **options: object) -> None:
    """Choose a class, and let it take over."""
    page.fill("time-out, s", PATIENCE_S)
    for label, value in options.items():
        page.fill(label.replace("_", " "), value)
    page.fill("class", choice)
    page.click("swap")


def test_a_message_is_published_into_an_external_port(server: PageServer) -> None:
    with closing(PageSocket(server, "/topic/scale/load")) as page:
        page.fill("message", "{load_n: 2.5, samples: [], note: from the page}")
        page.click("publish")
        page.says("published as number 1")
        page.fill("message", "{load_n: heavy, samples: []}")
        page.click("publish")
        page.says("load_n: expected a number")


def test_a_dry_run_and_a_shadow_say_what_would_be_and_change_nothing(server: PageServer, talk: Talk) -> None:
    accounts = Accounts(talk.palp, "talk", "scale", "/source/sample")
    was = accounts.graph.ask("scale", "info")["run"]
    before = accounts.swaps()
    with closing(PageSocket(server, "/node/scale")) as page:
        swap(page, "nodes.others:Quiet", dry_run=True)
        page.says(f"nodes.others:Quiet could take over from {was}; nothing was changed")
        page.fill("shadow, s", 0.2)
        page.click("swap")
        page.says("messages of both compared")
    assert (accounts.graph.ask("scale", "info")["run"], accounts.swaps()) == (was, before)


def test_a_swap_for_which_the_host_has_no_room_is_refused_and_the_graph_goes_on(
    server: PageServer, talk: Talk
) -> None:
    accounts = Accounts(talk.palp, "talk", "scale", "/source/sample")
    forks = psutil.Process(accounts.graph.node("scale").pid).parent()
    assert forks is not None
    before = forks.rlimit(psutil.RLIMIT_NOFILE)
    taken = {int(one.name) for one in Path(f"/proc/{forks.pid}/fd").iterdir()}
    room = next(number for number in itertools.count() if number not in taken)
    with closing(PageSocket(server, "/node/scale")) as page:
        forks.rlimit(psutil.RLIMIT_NOFILE, (room, before[1]))
        swap(page, "nodes.others:Quiet", dry_run=True)
        page.says("could not be started: Too many open files; the old node continues")
        forks.rlimit(psutil.RLIMIT_NOFILE, before)
        page.click("swap")
        page.says("nodes.others:Quiet could take over")
    accounts.go_on()


def test_a_viewer_that_is_killed_takes_neither_swap_nor_another_viewer_along(
    server: PageServer, talk: Talk, shared_palp: Palp
) -> None:
    accounts = Accounts(shared_palp, "talk", "scale", "/source/sample")
    before, process = accounts.swaps(), view(talk, shared_palp)
    other = PageServer(address_of(process))
    assert other.port != server.port
    with closing(PageSocket(other, "/node/scale")) as page:
        page.fill("shadow, s", 0.5)
        swap(page, "nodes.others:Calm")
        page.until(lambda one: one.get("text") in STEPS and "pill" in one.get("class", ()))
        process.kill()
        process.wait(PATIENCE_S)
    with closing(PageSocket(server, "/node/scale")) as page:
        page.says("nodes.others:Calm, process ")
    accounts.go_on()
    *earlier, last = accounts.swaps()
    assert (earlier, last.partition(":")[0]) == (before, "swapped")
