"""The site in a real browser: diagrams are drawn, nothing comes from elsewhere, a phone shows all of it."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from tests.support.palp import PATIENCE_S
from tests.support.view.browser import browser

__all__ = ["browser"]

PHONE = {"width": 390, "height": 844}


class Quiet(SimpleHTTPRequestHandler):
    """Serves a folder without a log."""

    def log_message(self, format: str, *arguments: object) -> None:
        pass


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """Serve the site on loopback."""
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


@pytest.mark.nightly
def test_diagrams_are_drawn_and_nothing_is_fetched_elsewhere(browser: Any, address: str, site: Path) -> None:
    names = [file.relative_to(site) for file in site.rglob("*.html") if 'class="diagram"' in file.read_text()]
    assert names
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_S * 1e3)
    asked: list[str] = []
    errors: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    for name in names:
        page.goto(f"{address}/{name}")
        page.wait_for_selector("div.diagram svg")
        assert page.locator("pre.diagram").count() == 0
    assert {url for url in asked if not url.startswith((address, "data:", "blob:"))} == set()
    assert errors == []
    page.close()


@pytest.mark.nightly
def test_no_page_is_wider_than_a_phone(browser: Any, address: str, site: Path) -> None:
    page = browser.new_page(viewport=PHONE)
    page.set_default_timeout(PATIENCE_S * 1e3)
    wide = []
    for file in sorted(site.rglob("*.html")):
        page.goto(f"{address}/{file.relative_to(site)}")
        if page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth"):
            wide.append(file.name)
    page.close()
    assert wide == []
