"""The page of the rig in a real browser: stop by click and by space bar, twice asked, blinded."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.palp import Palp
from tests.support.view.browser import Viewing, browser
from tests.support.view.rig_stub import SECRETS, launch_stub

__all__ = ["browser"]
STOPPED = "() => document.querySelector('[data-what=safety]').innerText === 'STOPPED'"
READY = "() => document.querySelector('[data-what=safety]').innerText === 'ready'"
WORDS = "words => document.querySelector('.urgent').innerText.includes(words)"


@pytest.fixture(scope="module")
def rig(browser: Any, shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory) -> Viewing:
    launch_stub(shared_palp, tmp_path_factory.mktemp("stub"), "stub")
    return Viewing(browser, shared_palp.start("view", "--no-browser", "--operate", "--graph", "stub"))


def released(rig: Viewing) -> None:
    rig.until(STOPPED)
    rig.page.get_by_role("button", name="acknowledge ...").click()
    rig.page.get_by_role("button", name="yes, leave the stop behind").click()
    rig.until(READY)


def test_it_shows_the_sweep_the_rig_and_what_came_of_it(rig: Viewing) -> None:
    page = rig.go("/own")
    rig.until("() => Number(document.querySelector('.rig-chart').dataset.points) > 100")
    rig.until("() => Number(document.querySelector('.rig-scene').dataset.frames) > 20")
    rig.until("() => Number(document.querySelector('.live-plot').dataset.points) > 20")
    for words in (
        "87.2 %", "level 0.3", "1 palpation of this trial", "bead, 4.321799 mm deep", "l4 takes over",
        "peak torques of training", "benchmarks/policies.py", "K7", "wrong", "ring: 16.1 mm",
    ):  # fmt: skip
        rig.says(words)
    assert page.locator("[data-what=trials] tbody tr").count() == 2
    assert page.locator("[data-what=trials]").is_visible()
    assert not page.get_by_role("button", name="show", exact=True).is_visible()
    assert rig.failures == []


@pytest.mark.parametrize("width", [390, 768])
def test_it_is_no_wider_than_a_phone_and_stop_is_in_sight_there(rig: Viewing, width: int) -> None:
    page, before = rig.page, rig.page.viewport_size
    page.set_viewport_size({"width": width, "height": 700})
    rig.go("/own")
    rig.says("ring: 16.1 mm")
    rig.until("() => document.scrollingElement.scrollWidth <= innerWidth")
    trials = page.locator("[data-what=trials]")
    assert not trials.is_visible()  # folded behind its heading
    page.get_by_role("button", name="show", exact=True).click()
    trials.locator("tbody tr").first.wait_for()
    assert page.evaluate("() => document.scrollingElement.scrollWidth <= innerWidth")
    page.get_by_role("button", name="hide", exact=True).click()
    trials.wait_for(state="hidden")
    page.mouse.wheel(0, 10_000)
    assert page.get_by_role("button", name="STOP (space bar)").evaluate(
        "b => b.getBoundingClientRect().top >= 0 && b.getBoundingClientRect().right <= innerWidth"
    )
    page.set_viewport_size(before)


@pytest.mark.parametrize(
    "path", ["/", "/own", "/topics", "/topic/safety/beat", "/node/safety", "/record", "/timeline"]
)
def test_stop_is_in_sight_on_every_page_and_works_by_one_click(rig: Viewing, path: str) -> None:
    page = rig.go(path)
    button = page.get_by_role("button", name="STOP (space bar)")
    button.wait_for()
    page.mouse.wheel(0, 10_000)
    assert button.evaluate(
        "b => b.getBoundingClientRect().top >= 0 && b.getBoundingClientRect().bottom <= innerHeight"
    )
    button.click()
    rig.until(WORDS, "latched: operator")
    released(rig)


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
    assert "loaded anew" not in page.inner_text("body")
    released(rig)


def test_a_node_of_a_rig_is_brought_to_rest_only_when_asked_twice(rig: Viewing) -> None:
    page = rig.go("/node/rig")
    page.get_by_role("button", name="deactivate ...").click()
    rig.says("This graph moves something")
    page.get_by_role("button", name="no", exact=True).click()
    page.get_by_role("button", name="deactivate ...").click()
    page.get_by_role("button", name="yes, deactivate").click()
    rig.says("deactivate: it is inactive now")
    page.get_by_role("button", name="activate", exact=True).click()
    rig.says("activate: it is active now")


def test_a_stop_that_was_pressed_while_the_connection_was_away_arrives_without_a_reload(rig: Viewing) -> None:
    page = rig.go("/own")
    page.evaluate("window.same = true")
    page.context.set_offline(True)
    page.keyboard.press("Space")
    rig.until(WORDS, "has not arrived")
    page.context.set_offline(False)
    rig.until(WORDS, "latched: operator")
    assert page.evaluate("window.same")
    released(rig)


def test_an_acknowledgement_is_asked_for_twice(rig: Viewing) -> None:
    page = rig.go("/own")
    page.keyboard.press("Space")
    rig.until(STOPPED)
    page.get_by_role("button", name="acknowledge ...").click()
    rig.says("nobody's hand is at the rig?")
    assert page.evaluate(STOPPED)
    page.get_by_role("button", name="no", exact=True).click()
    assert page.evaluate(STOPPED)
    released(rig)


class Bytes:
    """Every byte that a server sends to a page, but for NiceGUI's own files."""

    def __init__(self, page: Any) -> None:
        self.sent: list[bytes] = []
        self._answers: list[Any] = []
        page.on("response", lambda answer: self._answers.append(answer))
        page.on("websocket", lambda socket: socket.on("framereceived", lambda data: self._take(data)))

    def _take(self, data: str | bytes) -> None:
        self.sent.append(data.encode() if isinstance(data, str) else data)

    def collect(self) -> None:
        """Take what has been answered; before the next page is opened, when browsers forget it."""
        for answer in self._answers:
            if "/_nicegui/" not in answer.url and not 300 <= answer.status < 400:
                self.sent.append(answer.body())
        self._answers.clear()


def test_of_a_blinded_session_no_byte_that_is_sent_tells_depth_or_accuracy(
    browser: Any, shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory
) -> None:
    launch_stub(shared_palp, tmp_path_factory.mktemp("dark"), "dark", "blind:=true")
    viewing = Viewing(browser, shared_palp.start("view", "--no-browser", "--operate", "--graph", "dark"))
    page, sent = viewing.page, Bytes(viewing.page)
    for path in (
        "/", "/own", "/topics", "/topic/safety/beat", "/topic/rig/belief", "/topic/rig/torque",
        "/topic/rig/result", "/topic/rig/progress", "/topic/rig/trial", "/topic/rig/_events",
        "/node/safety", "/node/rig", "/record", "/timeline",
    ):  # fmt: skip
        viewing.go(path)
        if path not in ("/record", "/timeline"):  # there are none
            viewing.text_changes("[data-what=now]")
        sent.collect()
    viewing.go("/own")
    viewing.until("() => Number(document.querySelector('.rig-scene').dataset.frames) > 20")
    viewing.says("The session is blinded")
    viewing.says("estimation: 2 of 30 trials done")
    page.keyboard.press("Space")
    viewing.until(STOPPED)
    released(viewing)
    sent.collect()
    said = b"\n".join(sent.sent)
    assert b"estimation: 2 of 30" in said  # it is really what is sent
    found = {secret: said[max(said.find(secret) - 80, 0) :][:120] for secret in SECRETS if secret in said}
    assert found == {}
