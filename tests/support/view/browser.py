"""The pages in a real browser: the system's Chromium, without a window."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.palp import PATIENCE_S

NAMES = ("chromium", "chromium-browser")
RELOAD_MS = 30_000
OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]


def chromium() -> str:
    """Return where the system's Chromium is; without one, skip the test."""
    for name in NAMES:
        if found := shutil.which(name):
            return found
    pytest.skip("needs Chromium: apt-get install chromium")


@contextmanager
def chromium_running(path: str = "", *options: str) -> Iterator[Any]:
    """A browser for a while."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=path or chromium(), args=[*OPTIONS, *options])
        yield found
        found.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium_running(chromium()) as found:
        yield found


def address_of(process: subprocess.Popen[str]) -> str:
    """Return what a viewer prints: where it is."""
    assert process.stdout is not None
    line = process.stdout.readline().strip()
    assert line.startswith("http://127.0.0.1:"), line
    return line


class Page:
    """A page of the browser at a viewer's address; notes what it fetches from elsewhere and what fails.

    Args:
        browser: Chromium.
        address: As ``palp view`` has printed it.
        width: Of the window, in pixels.
    """

    def __init__(self, browser: Any, address: str, width: int = 1300) -> None:
        self.address = address
        self.page = browser.new_page(viewport={"width": width, "height": 900})
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
        """Go to one of its pages; return it."""
        self.page.goto(self.base + path)
        return self.page

    def until(self, condition: str, argument: object = None) -> None:
        """Wait until JavaScript says so."""
        try:
            self.page.wait_for_function(condition, arg=argument)
        except Exception as error:
            how = self.page.evaluate(
                "performance.getEntriesByType('navigation')[0].type"
            )  # it may load itself
            there = self.page.inner_text("body")
            raise AssertionError(f"{argument!r} never came; there is, after {how}: {there}") from error

    def text_changes(self, selector: str) -> None:
        """Wait until the text is another than now."""
        before = self.page.inner_text(selector)
        self.until("([at, text]) => document.querySelector(at).innerText !== text", [selector, before])

    def says(self, words: str) -> None:
        """Wait until the page says these words."""
        self.until("words => document.body.innerText.includes(words)", words)

    def plot(self, *fields: str, frames: int = 9) -> None:
        """Plot fields on the page of a topic, and wait until there is something, drawn so many times."""
        self.page.get_by_label("fields").click()
        for field in fields:
            self.page.get_by_role("option", name=field, exact=True).click()
            self.page.locator(".q-chip", has_text=field).wait_for()  # before the next: the server has it
        self.page.keyboard.press("Escape")
        self.page.wait_for_selector(".q-menu", state="hidden")
        self.until("() => Number(document.querySelector('.live-plot').dataset.points) > 20")
        self.until("most => Number(document.querySelector('.live-plot').dataset.frames) > most", frames)

    def download(self, button: str) -> Path:
        """Press a button until its file comes.

        A page that was cut off for longer than the viewer keeps it loads itself again, and a press is gone.
        """
        from playwright.sync_api import TimeoutError as NothingCame

        while True:
            try:
                with self.page.expect_download(timeout=RELOAD_MS) as download:
                    self.page.get_by_role("button", name=button).click()
            except NothingCame:
                kind = self.page.evaluate("performance.getEntriesByType('navigation')[0].type")
                assert kind == "reload", f"no file comes of {button!r}"
            else:
                return Path(download.value.path())

    def swap(self, run: str) -> None:
        """Choose a class on the page of a node, and let it take over."""
        self.page.get_by_label("class", exact=True).click()
        self.page.get_by_role("option", name=run, exact=True).click()
        self.page.get_by_role("button", name="swap", exact=True).click()


class Viewing(Page):
    """A viewer's process, and a page of the browser on it.

    Args:
        browser: Chromium.
        process: ``palp view --no-browser``, just started.
    """

    def __init__(self, browser: Any, process: subprocess.Popen[str], width: int = 1300) -> None:
        self.process = process
        super().__init__(browser, address_of(process), width)
