"""EMG and co-contraction, where the graph has them."""

from __future__ import annotations

import contextlib

import numpy as np
from nicegui import ui

from palp_core.errors import PalpError
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.palpation.live_page.muscles import muscle_text
from palp_core.view.pages.parts import text_element
from palp_core.view.pages.plot import SPAN_S, LivePlot
from palp_core.view.source.protocol import Sample, ViewSource, Watch
from palp_core.view.source.series import NO_POINTS, FieldSeries, shown

TICK_S = 0.1
PLOTS = (
    ("CoContraction", {"value": "co-contraction"}, "co-contraction"),
    ("EmgBlock", {"fds_v": "flexor (FDS), V", "edc_v": "extensor (EDC), V"}, "EMG"),
)
"""Type of message, what its fields are called here, and the file of a picture."""


class MusclePanel:
    """Level in words, co-contraction and EMG as plots."""

    def __init__(self, source: ViewSource, monitor: RigMonitor) -> None:
        self._source, self._monitor = source, monitor
        self._words = None
        if not any(name in monitor.topics for name, _, _ in PLOTS):
            return
        text_element("h2", "Muscles")
        self._words = text_element("div", "").props('data-what="level" role="status"')
        for name, fields, file in PLOTS[:1] if monitor.at_once else PLOTS:
            if name in monitor.topics:
                _plot(source, monitor.topics[name], fields, file, last_only=monitor.at_once)

    def show(self) -> None:
        """Show the level as it is."""
        if self._words is not None:
            latest, fast = self._monitor.latest, self._monitor.at_once
            now_s = self._source.overview().now_s
            words = muscle_text(latest("CoContraction"), latest("EmgReport"), now_s, fast=fast)
            self._words.text = words


def _plot(source: ViewSource, topic: str, fields: dict[str, str], file: str, *, last_only: bool) -> None:
    """Plot fields of a topic; of one that comes faster than anybody looks the last message at each look."""
    with contextlib.suppress(PalpError):
        watch = source.watch(topic)
        ui.context.client.on_delete(watch.close)
        series = [FieldSeries(field, watch.topic.json_schema) for field in fields]
        plot = LivePlot(file)
        plot.classes(replace="live-plot rig-small")
        plot.shape(names=list(fields.values()), slim=True)
        along = text_element("div", "time in s, by the graph's clock", "quiet")
        for one in (plot, along):
            one.set_visibility(False)  # axes without a point tell nothing
        waiting = [NO_POINTS for _ in series]
        seen = [-1]

        def tick() -> None:
            sample = _new(watch, seen) if last_only else watch.read_new()
            for place, field in enumerate(series):
                points = np.concatenate([waiting[place], *(field.add(message) for message in sample)])
                waiting[place] = shown(points, SPAN_S)
            if any(len(points) for points in waiting) and not plot.busy:
                for one in (plot, along):
                    one.set_visibility(True)
                plot.add(waiting)
                waiting[:] = [NO_POINTS for _ in series]

        ui.timer(TICK_S, tick)


def _new(watch: Watch, seen: list[int]) -> list[Sample]:
    """Return the last message, if it is not shown already."""
    last = watch.latest()
    if last is None or last.sequence == seen[0]:
        return []
    seen[0] = last.sequence
    return [last]
