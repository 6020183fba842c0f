"""The page of the rig in a real browser: stop by click and by space bar, twice asked."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.support.palp import Palp
from tests.support.view.browser import Page, Viewing, browser
from tests.support.view.page_socket import PageServer, PageSocket
from tests.support.view.rig_stub import launch_stub

__all__ = ["browser"]
pytestmark = pytest.mark.expensive("Chromium draws, while a graph and a viewer go on")
AT = re.compile(r"at [\d.]+ s")
"""When it is, as every page says."""
STOPPED = "() => document.querySelector('[data-what=safety]').innerText === 'STOPPED'"
READY = "() => document.querySelector('[data-what=safety]').innerText === 'ready'"
IN_SIGHT = """button => {
  const { top, bottom, right } = button.getBoundingClientRect();
  return top >= 0 && bottom <= innerHeight && right <= innerWidth;
}"""
WORDS = "words => document.querySelector('.urgent').innerText.includes(words)"


@pytest.fixture(scope="module")
def shown(browser: Any, shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory) -> Viewing:
    launch_stub(shared_palp, tmp_path_factory.mktemp("stub"), "stub")
    return Viewing(browser, shared_palp.start("view", "--no-browser", "--operate", "--graph", "stub"))


@pytest.fixture
def rig(shown: Viewing) -> Iterator[Viewing]:
    """The page, of which no script fails and which fetches nothing from elsewhere."""
    yield shown
    shown.page.goto("about:blank")  # what is no longer looked at is not drawn
    assert (shown.failures, shown.elsewhere) == ([], [])


def released(rig: Page) -> None:
    rig.until(STOPPED)
    rig.page.get_by_role("button", name="acknowledge ...").click()
    rig.page.get_by_role("button", name="yes, leave the stop behind").click()
    rig.until(READY)


THIN = """async () => {
  const loaded = performance.getEntriesByType("resource").map(one => one.name);
  const address = loaded.find(name => name.includes("live_plot.js"));
  const { aligned, thinned, tidy } = await import(address);
  const points = Array.from({ length: 20000 }, (_, i) => [100 + i / 2000, Math.sin(i * i)]);
  points[12345][1] = 7;
  points[777][1] = -7;
  const kept = thinned(points, 10);
  return {
    count: kept.length, peaks: kept.includes(points[12345]) && kept.includes(points[777]),
    ordered: kept.every((point, i) => !i || kept[i - 1][0] <= point[0]),
    tidy: [0.9999999999998999, -0.25, 1e-7, 0].map(tidy).join(" "),
    few: thinned(points.slice(0, 9), 10).length,
    gaps: thinned(points.toSpliced(9999, 0, [104.9, null]), 10).filter(one => one[1] === null).length,
    columns: JSON.stringify(aligned([[[1, 2], [1.5, null], [2, 3]], [[1.2, 5], [2, 6]]])),
  };
}"""
"""What a plot draws of more points than it has columns of pixels."""


@pytest.mark.nightly
def test_the_graph_is_drawn_and_a_topic_plotted_with_every_peak(rig: Viewing) -> None:
    page = rig.go("/")
    page.wait_for_selector("[data-node=safety]")
    rig.text_changes("[data-what=now]")
    page.click("[data-node=rig]")
    page.wait_for_url(re.compile("/node/rig$"))
    rig.go("/topic/rig/torque")
    rig.text_changes("[data-what=message]")
    rig.plot("torque_n_m")
    found = page.evaluate(THIN)
    assert (found["peaks"], found["ordered"], found["few"]) == (True, True, 9)
    assert found["gaps"] == 1
    assert json.loads(found["columns"]) == [[1, 1.2, 1.5, 2], [2, None, None, 3], [None, 5, None, 6]]
    assert found["tidy"] == "1 -0.25 1e-7 0"
    assert 1000 < found["count"] <= 1202


@pytest.mark.nightly
def test_it_shows_the_sweep_the_rig_and_what_came_of_it(rig: Viewing) -> None:
    page = rig.go("/own")
    rig.until("() => Number(document.querySelector('.rig-chart').dataset.points) > 100")
    rig.until("() => Number(document.querySelector('.rig-scene').dataset.frames) > 20")
    rig.until("() => Number(document.querySelector('.live-plot').dataset.points) > 20")
    for words in (
        "87.2 %", "level 0.3", "1 palpation of this trial", "bead, 4.321799 mm deep", "l4 takes over",
        "K7", "wrong", "ring: 16.1 mm",
    ):  # fmt: skip
        rig.says(words)
    assert page.locator("[data-what=trials] tbody tr").count() == 2
    assert page.locator("[data-what=trials]").is_visible()
    assert rig.failures == []


def pressed(rig: Viewing) -> None:
    """Stop by one click on the button, which is in sight however far down the page is."""
    button = rig.page.get_by_role("button", name="STOP (space bar)")
    button.wait_for()
    rig.page.mouse.wheel(0, 10_000)
    assert button.evaluate(IN_SIGHT)
    button.click()
    rig.until(WORDS, "latched: operator")
    released(rig)


def test_a_stop_works_by_one_click_and_while_the_connection_is_away_without_a_reload(rig: Viewing) -> None:
    page = rig.go("/own")
    page.evaluate("window.same = true")
    pressed(rig)
    page.context.set_offline(True)
    page.keyboard.press("Space")
    rig.until(WORDS, "has not arrived")
    page.context.set_offline(False)
    rig.until(WORDS, "latched: operator")
    assert page.evaluate("window.same")
    released(rig)


@pytest.mark.nightly
def test_stop_is_in_sight_on_every_page(rig: Viewing) -> None:
    for path in ("/", "/topics", "/topic/safety/beat", "/node/safety", "/timeline"):
        rig.go(path)
        pressed(rig)


def test_the_space_bar_stops_wherever_one_is_but_in_a_field(rig: Viewing) -> None:
    page = rig.go("/node/rig")
    field = page.get_by_label("depth_m", exact=True)
    field.fill("")
    field.press("Space")
    assert field.input_value() == " "
    assert page.evaluate(READY)
    page.get_by_role("link", name="Topics").focus()
    page.keyboard.press("Space")
    released(rig)
    page.get_by_role("button", name="restart").focus()  # what has the focus is not pressed by it
    page.keyboard.press("Space")
    rig.until(STOPPED)
    assert "restarting" not in page.inner_text("body")
    released(rig)


def test_a_node_of_a_rig_is_brought_to_rest_only_when_asked_twice(rig: Viewing) -> None:
    with closing(PageSocket(PageServer(rig.address), "/node/rig")) as page:
        page.click("deactivate ...")
        page.click("no")
        page.click("deactivate ...")
        page.click("yes, deactivate")
        page.says("deactivate: it is inactive now")
        page.click("activate")
        page.says("activate: it is active now")


@pytest.mark.nightly
def test_it_is_no_wider_than_a_phone_and_stop_is_in_sight_there(rig: Viewing) -> None:
    page, before = rig.page, rig.page.viewport_size
    page.set_viewport_size({"width": 390, "height": 700})
    rig.go("/own")
    rig.says("ring: 16.1 mm")
    rig.until("() => document.scrollingElement.scrollWidth <= innerWidth")
    page.mouse.wheel(0, 10_000)
    assert page.get_by_role("button", name="STOP (space bar)").evaluate(IN_SIGHT)
    page.set_viewport_size(before)
