"""A node of another host joins a graph that is looked at: it appears on the page as it happens."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest

from tests.support.hosts import joining, own_host, trusting
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer, PageSocket

pytest.importorskip("nicegui")


def drawn(element: dict[str, Any]) -> dict[str, str]:
    """Return how the nodes of a drawing stand; of any other element nothing."""
    return {node["name"]: node["health"] for node in element.get("props", {}).get("nodes", ())}


def test_a_node_that_joins_appears_on_the_page_and_one_that_has_gone_is_told() -> None:
    with own_host() as home, own_host() as away:
        trusting(home, away)
        graph = home.launch()
        server = PageServer(address_of(home.start("view", "--no-browser", "--graph", "home")))
        with closing(PageSocket(server)) as page:
            assert list(drawn(page.until(drawn)[1])) == ["ticker", "keeper"]
            wires = ("-r", "tick:=/keeper/tick")
            guest = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "drummer", *wires))
            page.until(lambda one: drawn(one).get("drummer") == "ok")
            guest.kill()
            page.until(lambda one: bool(drawn(one)) and drawn(one).get("drummer") != "ok")
        with closing(PageSocket(server, "/timeline")) as page:
            page.says("joined")
