"""A node of another host joins a graph that is looked at: it appears on the page as it happens."""

from __future__ import annotations

from typing import Any

from tests.support.hosts import joining, own_host, trusting
from tests.support.view.browser import Viewing, browser

__all__ = ["browser"]


def test_a_node_that_joins_appears_on_the_page_and_one_that_has_gone_is_told(browser: Any) -> None:
    with own_host() as home, own_host() as away:
        trusting(home, away)
        graph = home.launch()
        viewing = Viewing(browser, home.start("view", "--no-browser", "--graph", "home"))
        page = viewing.go("/")
        page.wait_for_selector("[data-node=ticker]")
        assert page.locator("[data-node=drummer]").count() == 0
        page.evaluate("window.same = true")
        wires = ("-r", "tick:=/keeper/tick")
        guest = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "drummer", *wires))
        page.wait_for_selector("[data-node=drummer].ok")
        viewing.says("/drummer")
        guest.kill()
        viewing.until("() => !document.querySelector('[data-node=drummer].ok')")
        assert page.evaluate("window.same")
        viewing.go("/timeline")
        page.get_by_role("button", name="/drummer, ").first.click()
        page.wait_for_selector("tr.chosen")
        viewing.says("joined")
        assert viewing.failures == []
