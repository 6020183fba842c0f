"""The pages in a real browser: Chromium without a window, one graph and one viewer for all."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.bag.info import bag_info
from tests.support.bags import bag
from tests.support.palp import PATIENCE_S, Palp
from tests.support.talkative import Talk, talk

__all__ = ["bag", "talk"]

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or ""
pytestmark = pytest.mark.skipif(not CHROMIUM, reason="there is no Chromium here: apt-get install chromium")
MARKUP = "<img src=x onerror='window.hacked=1'><script>window.hacked=1</script>"
LOUD = f'''
from nodes.talk import Scale, ScaleState


class LoudState(ScaleState):
    @classmethod
    def adopt(cls, old):
        return cls(**old.values)


class Loud(Scale):
    """A scale that prints what a page must not take for markup."""

    state: LoudState

    def on_configure(self):
        print({MARKUP!r}, flush=True)


class Broken(Scale):
    """Cannot start."""

    def on_configure(self):
        raise OSError("no scale is there")
'''


def address_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    line = process.stdout.readline().strip()
    assert line.startswith("http://127.0.0.1:"), line
    return line


class Viewing:
    """A viewer's process, and a page of the browser on it."""

    def __init__(self, browser: Any, process: subprocess.Popen[str]) -> None:
        self.process, self.address = process, address_of(process)
        self.page = browser.new_page(viewport={"width": 1300, "height": 900})
        self.page.set_default_timeout(PATIENCE_S * 1e3)
        self.failures: list[str] = []
        self.page.on("pageerror", lambda error: self.failures.append(str(error)))
        self.page.on("request", self._look)
        self.elsewhere: list[str] = []
        self.page.goto(self.address)
        self.base = self.page.url.rstrip("/")

    def _look(self, request: Any) -> None:
        if not request.url.startswith(("http://127.0.0.1:", "data:", "blob:", "ws://127.0.0.1:")):
            self.elsewhere.append(request.url)

    def go(self, path: str) -> Any:
        self.page.goto(self.base + path)
        return self.page

    def until(self, condition: str, argument: object = None) -> None:
        """Wait until JavaScript says so."""
        try:
            self.page.wait_for_function(condition, arg=argument)
        except Exception as error:
            raise AssertionError(
                f"{argument!r} never came; there is: {self.page.inner_text('body')}"
            ) from error

    def text_changes(self, selector: str) -> None:
        before = self.page.inner_text(selector)
        self.until("([at, text]) => document.querySelector(at).innerText !== text", [selector, before])

    def says(self, words: str) -> None:
        self.until("words => document.body.innerText.includes(words)", words)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as driver:
        options = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        found = driver.chromium.launch(executable_path=CHROMIUM, args=options)
        yield found
        found.close()


@pytest.fixture(scope="module")
def viewing(browser: Any, talk: Talk, shared_palp: Palp) -> Viewing:
    (talk.folder / "nodes/loud.py").write_text(LOUD, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(talk.folder)  # bags are made where it was started
        process = shared_palp.start("view", "--no-browser", "--graph", "talk")
    return Viewing(browser, process)


def test_the_first_page_draws_the_graph_and_its_values_change(viewing: Viewing) -> None:
    page = viewing.go("/")
    for node in ("source", "scale"):
        page.wait_for_selector(f"[data-node={node}]")
    page.wait_for_selector(".wire text")
    assert page.inner_text("[data-what=graph]") == "talk"
    viewing.says("nodes.talk:Scale")
    viewing.text_changes("[data-what=now]")
    page.click("[data-node=scale]")
    page.wait_for_url(re.compile("/node/scale$"))


def test_a_topic_shows_its_messages_and_plots_them(viewing: Viewing) -> None:
    page = viewing.go("/topic/source/sample")
    viewing.text_changes("[data-what=message]")
    assert "torque_n_m: [" in page.inner_text("[data-what=message]")
    viewing.until("() => document.querySelector('[data-what=rate]').innerText.endsWith('Hz')")
    page.get_by_label("fields").click()
    page.get_by_role("option", name="torque_n_m").click()
    page.get_by_role("option", name="index").click()
    page.keyboard.press("Escape")
    page.wait_for_selector(".q-menu", state="hidden")
    viewing.until("() => Number(document.querySelector('.live-plot').dataset.points) > 20")
    viewing.until("() => Number(document.querySelector('.live-plot').dataset.frames) > 9")
    with page.expect_download() as download:
        page.get_by_role("button", name="CSV").click()
    lines = Path(download.value.path()).read_text(encoding="utf-8").splitlines()
    assert lines[0] == "time_s,field,value"
    assert {line.split(",")[1] for line in lines[1:]} == {"torque_n_m [N m]", "index"}
    with page.expect_download() as download:
        page.get_by_role("button", name="PNG").click()
    assert Path(download.value.path()).read_bytes().startswith(b"\x89PNG")


def test_a_parameter_is_set_and_one_out_of_its_bounds_is_refused_in_words(
    viewing: Viewing, talk: Talk
) -> None:
    page = viewing.go("/node/source")
    page.get_by_label("rare_hz", exact=True).fill("-3")
    page.get_by_label("set rare_hz").click()
    viewing.says("Expected `float` >")
    page.get_by_label("name", exact=True).fill(MARKUP)
    page.get_by_label("set name").click()
    viewing.says("name is <img")
    assert talk.told("param", "get", "/source", "name", "--graph", "talk")["value"] == MARKUP  # type: ignore[index]
    viewing.go("/topic/source/sample")
    viewing.says(f"name: {MARKUP}")
    assert page.evaluate("window.hacked") is None


def test_a_message_is_published_into_an_external_port(viewing: Viewing) -> None:
    page = viewing.go("/topic/scale/load")
    page.get_by_label("message").fill("{load_n: 2.5, samples: [], note: from the page}")
    page.get_by_role("button", name="publish", exact=True).click()
    viewing.says("published as number 1")
    page.get_by_label("message").fill("{load_n: heavy, samples: []}")
    page.get_by_role("button", name="publish", exact=True).click()
    viewing.says("load_n: expected a number")


def test_a_swap_is_seen_step_by_step_and_what_it_prints_is_text(viewing: Viewing) -> None:
    page = viewing.go("/node/scale")
    viewing.says("3 classes of the workspace fit its wires")
    page.get_by_label("time-out, s").fill(str(PATIENCE_S))
    choose(page, "nodes.loud:Broken")
    viewing.says("rolled back at step 'configure'")
    viewing.says("no scale is there")
    choose(page, "nodes.loud:Loud")
    viewing.says("nodes.talk:Scale -> nodes.loud:Loud")
    viewing.until("() => document.querySelectorAll('[data-what=steps] .ok').length === 9")
    viewing.until("words => document.querySelector('[data-what=log]').innerText.includes(words)", MARKUP)
    assert page.evaluate("window.hacked") is None
    viewing.go("/timeline")
    viewing.says("swap failed")
    viewing.says("nodes.talk:Scale -> nodes.loud:Loud")


def choose(page: Any, run: str) -> None:
    field = page.get_by_label("class", exact=True)
    field.click()
    page.get_by_role("option", name=run, exact=True).click()
    page.get_by_role("button", name="swap", exact=True).click()


def test_a_recording_is_started_and_ended(viewing: Viewing, talk: Talk) -> None:
    page = viewing.go("/record")
    page.get_by_label("name; empty: graph and time").fill("../elsewhere")
    page.get_by_role("button", name="record", exact=True).click()
    viewing.says("is no name of a bag")
    page.get_by_label("name; empty: graph and time").fill("taken")
    page.get_by_role("button", name="record", exact=True).click()
    viewing.says("recording")
    page.get_by_role("button", name="stop", exact=True).click()
    viewing.says("whole: nothing is missing")
    assert bag_info(talk.folder / "taken").complete
    page.get_by_label("name; empty: graph and time").fill("last")
    page.get_by_label("keep only the last, s").fill("60")
    page.get_by_role("button", name="record", exact=True).click()
    viewing.says("the last 60 s are kept")
    page.get_by_role("button", name="write snapshot").click()
    viewing.says(f"{talk.folder / 'last'}: ")
    assert bag_info(talk.folder / "last").message_count > 0
    page.get_by_role("button", name="stop", exact=True).click()
    viewing.says("heard ")


def test_nothing_is_fetched_from_elsewhere_and_no_script_fails(viewing: Viewing) -> None:
    assert viewing.elsewhere == []
    assert viewing.failures == []


def test_of_a_read_only_page_nothing_changes_the_graph(browser: Any, talk: Talk, shared_palp: Palp) -> None:
    viewing = Viewing(browser, shared_palp.start("view", "--no-browser", "--graph", "talk", "--read-only"))
    page = viewing.go("/node/source")
    page.get_by_label("rate_hz", exact=True).fill("1")
    page.get_by_label("set rate_hz").click()
    viewing.says("this page is read-only")
    assert talk.told("param", "get", "/source", "rate_hz", "--graph", "talk")["value"] == 100.0  # type: ignore[index]
    viewing.process.kill()
    viewing.process.wait(PATIENCE_S)
    assert talk.told("lifecycle", "get", "/source", "--graph", "talk") == {"/source": "active"}
    assert talk.process.poll() is None


def test_a_bag_is_shown_with_a_time_bar(browser: Any, shared_palp: Palp, bag: Path) -> None:
    viewing = Viewing(browser, shared_palp.start("view", bag, "--no-browser"))
    page = viewing.go("/topic/torque/block")
    viewing.says("number 1, at 0.000 s")
    page.locator(".q-slider").click()  # at its middle
    viewing.until("() => !document.querySelector('[data-what=stamp]').innerText.startsWith('number 1,')")
    page.get_by_role("button", name="play", exact=True).click()
    viewing.says("number 200, at 0.199 s")
