"""The pages without a browser: NiceGUI's own simulated user, and sources that a test speaks for."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.graph.discovery.troubles import Trouble
from palp_core.graph.messages.topic import Topic
from palp_core.view.source.operator import READ_ONLY
from palp_core.view.source.overview import (
    ACTION,
    NodeState,
    Overview,
    WireState,
    actions_as_one,
)

pytest.importorskip("nicegui")
pytest.importorskip("nicegui.testing.user_simulation")

from nicegui import ui

from palp_core.view.pages.frame import time_bar
from palp_core.view.pages.graph import (
    ASKED,
    EndPanel,
    GraphDrawing,
    graph_page,
    pairs_of,
    wire_line,
    wire_text,
)
from palp_core.view.pages.layout import HEIGHT, WIDTH, layout
from palp_core.view.pages.parts import labelled
from palp_core.view.pages.plot import CHOOSE, LivePlot, plot_panel
from palp_core.view.pages.viewer import OwnPage, Viewer
from tests.support.view.fake_source import FakeOperator, FakeSource, FakeWatch
from tests.support.view.simulated_user import simulated

ROOT = Path(__file__).resolve().parents[2]
MARKUP = "<script>alert(1)</script>"
SAMPLE = Topic(name="/source/sample", type="Sample", node="source", json_schema={"type": "object"})

NUMBER = {"type": "object", "properties": {"x": {"type": "number"}}}


class ToySource(FakeSource):
    """Two nodes and a wire."""

    def __init__(self) -> None:
        nodes = [
            NodeState(name="source", lifecycle="active", health="ok"),
            NodeState(name="sink", lifecycle="active"),
        ]
        wires = [WireState(topic="/source/sample", source="source", reader="sink", rate_hz=100.0)]
        super().__init__(Overview(kind="graph", title="toy", clock="sim", nodes=nodes, wires=wires), [SAMPLE])


def test_what_is_wrong_is_on_the_page_as_text_and_a_node_that_joins() -> None:
    source = ToySource()
    trouble = Trouble("/sink", "error", MARKUP, "palp logs sink")
    source.change(troubles=[trouble], title=MARKUP)

    async def look(user: Any) -> None:
        await user.should_see("something is badly wrong")
        await user.should_see("error: /sink")
        await user.should_see(MARKUP)
        await user.should_see("palp logs sink")
        await user.should_see("/source/sample")
        late = NodeState(name="late", lifecycle="active")  # it joins
        source.change(nodes=[*source.now.nodes, late], troubles=[Trouble("/sink", "error", "resting")])
        await user.should_see("/late")
        await user.should_see("at rest")  # the word of the launch file's own page
        await user.should_not_see("something is badly wrong")
        (drawing,) = user.find(GraphDrawing).elements
        assert [node["name"] for node in drawing.props["nodes"]] == ["source", "sink", "late"]

    def own(_: Viewer) -> None: ...

    own.heading = lambda wrong: ("at rest", []) if wrong[0].text == "resting" else None  # type: ignore[attr-defined]
    simulated(lambda: graph_page(Viewer(source=source, own_page=OwnPage(own))), look)


def test_the_example_of_the_docs_is_a_page_of_ones_own() -> None:
    code = re.findall(
        r"```python\n(.*?)```", (ROOT / "docs/how_to/own_page.md").read_text(encoding="utf-8"), re.DOTALL
    )[0]
    assert len(code.splitlines()) <= 36
    names: dict[str, Any] = {}
    exec(code, names)
    source, pressed = ToySource(), FakeOperator(ok=True)
    own = OwnPage(names["gauge"])
    viewer = Viewer(source=source, operator=pressed, own_page=own)  # type: ignore[arg-type]

    def put() -> None:
        own.fill_strip(viewer)
        own.fill(viewer)

    async def look(user: Any) -> None:
        await user.should_see("no block yet")
        source.add("Sample", 1_500_000_000, {"index": 6})
        await user.should_see("block 6 at 1.5 s")
        user.find("stop").click()
        await user.should_see("stopped")
        assert pressed.calls == [("safety", "stop", {}, True)]

    simulated(put, look)


def test_a_page_of_ones_own_that_fails_says_so_and_harms_nothing() -> None:
    def broken(viewer: Viewer) -> None:
        raise RuntimeError("no such thing")

    async def look(user: Any) -> None:
        await user.should_see("the launch file's own page failed: RuntimeError: no such thing")

    simulated(lambda: OwnPage(broken).fill(Viewer(source=ToySource())), look)


def test_a_wire_says_rate_latency_and_loss() -> None:
    wire = WireState(
        topic="/source/sample", source="source", reader="sink", rate_hz=1000.4, received=5, lost=2, late=1,
        latency_p50_s=4e-4, latency_p99_s=1e-3,
    )  # fmt: skip
    assert wire_line(wire) == "sample 1000 Hz 0.40 ms 2 lost"
    assert wire_text(wire) == "/source/sample -> /sink: 5 received, 2 lost, 1 late, p99 1.00 ms"
    assert list(pairs_of([wire, wire])) == [("source", "sink")]


def part(topic: str, reader: str, received: int | None = 1, p50_s: float | None = None) -> WireState:
    source, rate_hz = topic.split("/")[1], None if received is None else 2.0
    return WireState(
        topic=topic, source=source, reader=reader, received=received, rate_hz=rate_hz, latency_p50_s=p50_s
    )


@pytest.mark.parametrize("known", [True, False])
def test_the_parts_of_an_action_between_two_nodes_are_one_wire_and_of_a_bag_uncounted(known: bool) -> None:
    calls = ("send_goal", "cancel_goal", "get_result")
    parts = [
        part("/arm/pose", "carrier", 7),
        *(part(f"/carrier/lift/_action/{call}", "arm") for call in calls),
        part("/arm/move/_action/feedback", "carrier", 10, 0.25),
        part("/arm/move/_action/status", "carrier", 6, 0.5),
        *(part(f"/arm/move/_action/{call}/carrier/lift/_action/{call}", "carrier") for call in calls),
        part("/arm/move/_action/status", "other", 6),
    ]
    if not known:
        parts = [part(one.topic, one.reader, None) for one in parts]
    pose, action, other = actions_as_one(parts)
    assert pose == parts[0]
    assert (action.source, action.reader, action.topic) == ("carrier", "arm", "/arm/move")
    assert (action.type, other.source, other.reader) == (ACTION, "other", "arm")
    counts = (action.received, action.rate_hz, action.latency_p50_s, other.received)
    assert counts == ((22, 16.0, 0.5, 6) if known else (None,) * 4)
    assert wire_text(action) == "/arm/move, an action for /carrier" + (": 22 received" if known else "")


def test_in_a_graph_of_any_size_each_node_has_a_place_of_its_own_and_each_wire_a_way() -> None:
    names = [f"n{i}" for i in range(30)]
    every = [(a, b) for a in names for b in names]
    for known, wires in (([], []), (names, []), (names, every)):
        found = layout(known, wires)
        places = [(place.x, place.y) for place in found.places.values()]
        assert all(
            abs(a[0] - b[0]) >= WIDTH or abs(a[1] - b[1]) >= HEIGHT for a, b in combinations(places, 2)
        )
        assert all(0 <= x <= found.width - WIDTH and 0 <= y <= found.height - HEIGHT for x, y in places)
        assert (set(found.places), set(found.routes)) == (set(known), set(wires))


@pytest.mark.parametrize("fast", [False, True])
def test_the_time_axis_moves_on_between_messages_unless_the_graph_outruns_the_clock(fast: bool) -> None:

    watch = FakeWatch([], msgspec.structs.replace(SAMPLE, json_schema=NUMBER))

    async def look(user: Any) -> None:
        (plot,) = user.find(LivePlot).elements
        assert plot.props["even"] is not fast
        assert (plot.props["title"], plot.props["along"]) == ("/source/sample", "simulated time in s")
        await user.should_see(CHOOSE)
        (choice,) = [one for one in user.find(ui.select).elements if "fields" in one.props["label"]]
        choice.value = ["x"]
        await user.should_not_see(CHOOSE)

    simulated(lambda: plot_panel(watch, fast=fast, clock="sim"), look)


def test_a_parameters_name_is_read_out_and_never_an_attribute() -> None:

    name = f'x" :onclick="window.hacked=1" {MARKUP}'

    async def look(user: Any) -> None:
        (field,) = user.find(ui.input).elements
        assert field.props["aria-label"] == name
        assert not [prop for prop in field.props if "onclick" in prop]

    simulated(lambda: labelled(ui.input(), name), look)


def test_the_end_of_the_graph_asks_twice_and_is_dead_where_it_may_not_be_pressed() -> None:

    pressed, ended = FakeOperator(), list[str]()
    pressed.end = lambda: ended.append("end")  # type: ignore[attr-defined]
    panels: list[EndPanel] = []
    viewer = Viewer(source=ToySource(), operator=pressed)  # type: ignore[arg-type]

    async def look(user: Any) -> None:
        user.find("End the graph ...").click()
        assert ended == []
        user.find("yes, end the graph").click()
        await user.should_see(ASKED)
        assert ended == ["end"]
        pressed.refused = READ_ONLY
        await user.should_see(READ_ONLY)
        (button,) = user.find(kind=ui.button, content="End the graph ...").elements
        assert not button.enabled

    simulated(lambda: panels.append(EndPanel(viewer)), look)


def test_the_time_bar_shows_where_the_bag_is_whatever_page_plays_it() -> None:

    class Recording:
        start_s, end_s, at_s, playing = 5.0, 6.0, 6.0, False

        def play(self, *, on: bool = True) -> None:
            self.playing = on

        def seek(self, at_s: float) -> None:
            self.at_s = at_s

    recording = Recording()

    async def look(user: Any) -> None:
        await user.should_see("6.000 s, of 5.000 to 6.000")
        user.find("play").click()
        await user.should_see("pause")
        recording.at_s = 5.25  # time goes on, whether or not this page has begun it
        await user.should_see("5.250 s, of 5.000 to 6.000")
        recording.playing = False
        await user.should_see("play")
        (bar,) = user.find(ui.slider).elements
        assert bar.value == 5.25
        bar.value = 5.75  # a person moves it
        await user.should_see("5.750 s, of 5.000 to 6.000")
        assert recording.at_s == 5.75

    simulated(lambda: time_bar(recording), look)  # type: ignore[arg-type]
