"""EMG and co-contraction, where the graph has them."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
from nicegui import ui

from palp_core.errors import PalpError
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.view.pages.parts import text_element
from palp_core.view.pages.plot import SPAN_S, LivePlot
from palp_core.view.source.protocol import Sample, ViewSource, Watch
from palp_core.view.source.series import NO_POINTS, FieldSeries, shown

LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Of the level's index: the paper's five."""

FLOWING = ("ok", "streaming")
"""Conditions of a source whose blocks come."""

SILENT_S = 2.0
"""Blocks come many times a second."""
SILENT_FAST_S = 60.0
"""Of a graph that goes faster than anybody looks."""


def muscle_text(
    cocontraction: dict[str, Any] | None,
    report: dict[str, Any] | None,
    now_s: float | None = None,
    *,
    fast: bool = False,
) -> str:
    """Return the level of the latest peak, how many bursts there were, and what is wrong with the source.

    >>> muscle_text({"level": 2, "level_defined": True, "burst_count": 7, "value": [0.25]}, None)
    'co-contraction 0.25; level 0.3 at its latest peak (third of five); 7 bursts'
    >>> muscle_text(None, {"condition": "ok", "text": ""})
    'EMG comes; no co-contraction yet'
    """
    parts = []
    if cocontraction is not None:
        if cocontraction["value"]:
            parts.append(f"co-contraction {cocontraction['value'][-1]:.2f}")
        if cocontraction["level_defined"] and cocontraction["level"] < len(LEVELS):
            place = ("first", "second", "third", "fourth", "fifth")[cocontraction["level"]]
            parts.append(f"level {LEVELS[cocontraction['level']]:g} at its latest peak ({place} of five)")
        else:
            parts.append("no peak yet, so no level")
        count = cocontraction["burst_count"]
        parts.append(f"{count} burst{'s' if count != 1 else ''}")
        if now_s is not None:
            heard_s = cocontraction["stamp_ns"] / 1e9
            if now_s - heard_s > (SILENT_FAST_S if fast else SILENT_S):
                parts.append(f"silent since {heard_s:.0f} s on the graph's clock")
    if report is not None:
        if report["condition"] not in FLOWING:
            parts.append(": ".join(part for part in (report["condition"], report["text"]) if part))
        elif cocontraction is None:
            parts.append("EMG comes; no co-contraction yet")
    return "; ".join(parts) or "nothing heard yet"


TICK_S = 0.1
PLOTS = (
    ("CoContraction", {"value": "co-contraction"}, "co-contraction"),
    ("EmgBlock", {"fds_v": "flexor (FDS), V", "edc_v": "extensor (EDC), V"}, "EMG"),
)
"""Type of message, what its fields are called here, and the file of a picture."""


class MusclePanel:
    def __init__(self, source: ViewSource, monitor: RigMonitor) -> None:
        self._source, self._monitor = source, monitor
        self._text = None
        if not any(name in monitor.topics for name, _, _ in PLOTS):
            return
        text_element("h2", "Muscles")
        self._text = text_element("div", "").props('data-what="level" role="status"')
        for name, fields, file in PLOTS[:1] if monitor.at_once else PLOTS:
            if name in monitor.topics:
                _plot(source, monitor.topics[name], fields, file, last_only=monitor.at_once)

    def show(self) -> None:
        if self._text is not None:
            latest, fast = self._monitor.latest, self._monitor.at_once
            now_s = self._source.overview().now_s
            text = muscle_text(latest("CoContraction"), latest("EmgReport"), now_s, fast=fast)
            self._text.text = text


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
            samples = _new(watch, seen) if last_only else watch.read_new()
            for place, field in enumerate(series):
                points = np.concatenate([waiting[place], *(field.add(message) for message in samples)])
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
