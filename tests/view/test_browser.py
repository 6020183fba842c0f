"""What only a real browser shows of the pages: Chromium without a window, one graph, one viewer."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
import numpy as np
import pytest

from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from tests.support.bags import Block, bag, describe, frame
from tests.support.palp import Palp
from tests.support.talkative import Talk, talk
from tests.support.view.browser import Viewing, browser

__all__ = ["bag", "browser", "talk"]
pytestmark = [pytest.mark.nightly, pytest.mark.expensive("Chromium draws, while a graph and a viewer go on")]

MARKUP = "<img src=x onerror='window.hacked=1'><script>window.hacked=1</script>"
HOSTILE = (
    MARKUP,
    "</title><script>window.hacked=1</script>",
    "`${window.hacked=1}`",
    'x" :onclick="window.hacked=1" :y="window.hacked=1',
    "{{constructor.constructor('window.hacked=1')()}}",
)
"""Names and words that are markup if they are put into a page as they are."""
NOTHING_STANDS_OUT = "() => document.scrollingElement.scrollWidth <= innerWidth"


@pytest.fixture(scope="module")
def shown(browser: Any, talk: Talk, shared_palp: Palp) -> Viewing:
    return Viewing(browser, shared_palp.start("view", "--no-browser", "--graph", "talk"))


@pytest.fixture
def viewing(shown: Viewing) -> Iterator[Viewing]:
    """The page, of which no script fails and which fetches nothing from elsewhere."""
    yield shown
    shown.page.goto("about:blank")  # what is no longer looked at is not drawn
    assert (shown.failures, shown.elsewhere) == ([], [])


def test_the_first_page_draws_the_graph_and_its_values_change(viewing: Viewing) -> None:
    page = viewing.go("/")
    for node in ("source", "scale"):
        page.wait_for_selector(f"[data-node={node}]")
    page.wait_for_selector(".wire text")
    assert page.inner_text("[data-what=graph]") == "talk"
    viewing.says("nodes.talk:Source")
    viewing.text_changes("[data-what=now]")
    page.click("[data-node=scale]")
    page.wait_for_url(re.compile("/node/scale$"))
    viewing.go("/").locator("td a", has_text="/source/sample").first.click()
    page.wait_for_url(re.compile("/topic/source/sample$"))


def test_a_topic_shows_its_messages_and_plots_them(viewing: Viewing) -> None:
    page = viewing.go("/topic/source/sample")
    viewing.text_changes("[data-what=message]")
    assert "torque_n_m: [" in page.inner_text("[data-what=message]")
    viewing.until("() => document.querySelector('[data-what=rate]').innerText.includes('Hz')")
    viewing.plot("torque_n_m", "index")


def test_the_address_has_what_is_plotted(viewing: Viewing) -> None:
    page = viewing.page
    viewing.go(f"/topic/source/sample?fields=torque_n_m[{'9' * 5000}],index&window=nonsense")
    page.locator(".q-chip", has_text="index").wait_for()
    viewing.says("10 s")
    viewing.go("/topic/source/sample?fields=index,no_such,torque_n_m[0]&window=60")
    page.locator(".q-chip", has_text="torque_n_m[0]").wait_for()
    assert page.locator(".q-chip").count() == 2
    viewing.says("1 min")
    assert viewing.download("PNG").read_bytes().startswith(b"\x89PNG")


INKED = """() => {
  const canvas = document.querySelector(".live-plot canvas"), look = document.createElement("div");
  look.style.color = getComputedStyle(document.body).getPropertyValue("--plot-0");
  document.body.append(look);
  const [red, green, blue] = getComputedStyle(look).color.match(/[0-9.]+/g).map(Number);
  look.remove();
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4) {
    const off = Math.abs(data[i] - red) + Math.abs(data[i + 1] - green) + Math.abs(data[i + 2] - blue);
    if (data[i + 3] > 128 && off < 30) count++;
  }
  return count;
}"""
"""How many pixels of the plot have the colour of its first series."""


def test_a_paused_plot_stays_as_it_is(viewing: Viewing) -> None:
    page = viewing.go("/topic/source/sample")
    viewing.plot("torque_n_m")
    viewing.until(f"() => ({INKED})() > 100")

    page.get_by_role("button", name="pause").click()
    page.get_by_role("button", name="go on").wait_for()
    viewing.text_changes("[data-what=message]")
    page.get_by_label("window").click()
    page.get_by_role("option", name="10 min").click()
    viewing.text_changes("[data-what=message]")
    assert page.evaluate(INKED) > 100
    page.get_by_role("button", name="go on").click()
    frames = page.evaluate("() => Number(document.querySelector('.live-plot').dataset.frames)")
    viewing.until(f"() => Number(document.querySelector('.live-plot').dataset.frames) > {frames}")


def test_no_page_is_wider_than_a_phone(viewing: Viewing) -> None:
    page = viewing.page
    before = page.viewport_size
    page.set_viewport_size({"width": 390, "height": 800})
    for path in ("/", "/topic/source/sample", "/topics", "/node/scale", "/timeline"):
        viewing.go(path)
        viewing.says("for 0:")
        viewing.until(NOTHING_STANDS_OUT)
    page.set_viewport_size(before)


def test_what_a_bag_of_somebody_else_says_is_text_and_no_markup(
    browser: Any, shared_palp: Palp, tmp_path: Path
) -> None:
    names = {name: f"/{quote(name, safe='')}/block" for name in HOSTILE}
    topics = []
    for name in names:
        known = describe(Block, f"/{name}/block")
        fields = {"torque_n_m": {**known.json_schema["properties"]["torque_n_m"], "x-unit": name}}
        schema = {**known.json_schema, "properties": {**known.json_schema["properties"], **fields}}
        topics.append(msgspec.structs.replace(known, type=name, json_schema=schema))
    recorder = BagRecorder(BagWriter(tmp_path / "run"), topics)
    for sequence, topic in itertools.product((1, 2), topics):
        block = Block(stamp_ns=sequence, torque_n_m=np.ones(4), text="".join(HOSTILE))
        recorder(sequence, frame(topic.name, block, sequence, sequence * 10_000_000))
    launch = {
        "graph": "".join(HOSTILE),
        "clock": MARKUP,
        "publishes": {name: ["block"] for name in HOSTILE},
        "listens": {name: [topic.name for topic in topics] for name in HOSTILE},
    }
    recorder.attach(LAUNCH_ATTACHMENT, msgspec.json.encode(launch))
    recorder.close()
    viewing = Viewing(browser, shared_palp.start("view", tmp_path / "run", "--no-browser"))
    page = viewing.page
    page.wait_for_selector("[data-node]")
    viewing.go("/topics")
    for name, path in names.items():
        viewing.says(name)
        viewing.go(f"/node/{quote(name, safe='')}")
        viewing.go(f"/topic{path}")
        viewing.says(f"text: {HOSTILE[0]}")
        page.get_by_label("fields").click()
        page.get_by_role("option", name="torque_n_m").click()
        page.keyboard.press("Escape")
        viewing.until("() => Number(document.querySelector('.live-plot').dataset.frames) > 0")
        assert page.evaluate("window.hacked") is None
        viewing.go("/topics")
    assert (viewing.failures, viewing.elsewhere) == ([], [])
    page.close()


def test_a_bag_is_shown_with_a_time_bar(browser: Any, shared_palp: Palp, bag: Path) -> None:
    viewing = Viewing(browser, shared_palp.start("view", bag, "--no-browser"))
    page = viewing.go("/topic/torque/block")
    viewing.says("number 200, at 0.199 s")  # its end, by which all of it has been published
    page.locator(".q-slider").click()  # at its middle
    viewing.until("() => !document.querySelector('[data-what=stamp]').innerText.startsWith('number 200,')")
    page.get_by_role("button", name="play", exact=True).click()
    viewing.says("number 200, at 0.199 s")
    page.set_viewport_size({"width": 390, "height": 800})
    for path in ("/", "/topic/torque/block", "/timeline"):
        viewing.go(path)
        page.locator(".q-slider").wait_for()
        viewing.until(NOTHING_STANDS_OUT)
