"""Panels of the rig's page: torque and drawing, belief, muscles, and what has come of the session."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.element import Element
from nicegui.elements.echart import EChart  # its import is what makes ECharts known to the page

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.live_page.monitor import RigMonitor, node_of, session_folder
from palp_core.palpation.live_page.sweeps import Band, Point
from palp_core.palpation.live_page.trials import JudgedProbe, TrialBelief, TrialRow
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import StagePath
from palp_core.palpation.perception.statistics.statistics import Proportion
from palp_core.units import Float64Array
from palp_core.view.pages.parts import Cell, PacedElement, table, text_element
from palp_core.view.pages.plot import SPAN_S, LivePlot
from palp_core.view.source.protocol import Sample, ViewSource, Watch
from palp_core.view.source.series import NO_POINTS, FieldSeries, shown, thinned

__all__ = ["EChart"]

MOST_POINTS, FEW_POINTS = 600, 60
"""Of a whole sweep, no more than a chart has columns of pixels; of a twentieth of a second."""
MOVE_MS = 60
"""Between two looks the drawing moves evenly."""
LIFT_M = 0.020
MOST_ROWS = 30
MOST_GUARDS = 12
LEVELS = ((0.1, "first"), (0.2, "second"), (0.3, "third"), (0.4, "fourth"), (0.5, "fifth"))
"""The paper's five, by their index."""
FLOWING = ("ok", "streaming")
"""Conditions of a source whose blocks come."""
SILENT_S, SILENT_FAST_S = 2.0, 60.0
"""Blocks come many times a second; the second, of a graph that goes faster than anybody looks."""
PLOT_S = 0.1
PLOTS = (
    ("CoContraction", {"value": "co-contraction"}, "co-contraction"),
    ("EmgBlock", {"fds_v": "flexor (FDS), V", "edc_v": "extensor (EDC), V"}, "EMG"),
)
"""Type of message, what its fields are called here, and the file of a picture."""


class SweepChart(PacedElement, component="sweep_chart.js"):  # type: ignore[call-arg]
    def __init__(self, path_m: tuple[float, float]) -> None:
        super().__init__()
        self._shape: tuple[Any, ...] = ()
        self.shape([], path_m, "")

    def shape(self, bands: list[Band], path_m: tuple[float, float], words: str) -> None:
        shape = ([(band.depth_mm, band.sweep_count, band.low_n_mm[:1]) for band in bands], path_m, words)
        if shape == self._shape:
            return
        self._shape = shape
        drawn = [
            {
                "label": f"{b.depth_mm:g} mm deep",
                "places": b.places_mm,
                "low": b.low_n_mm,
                "high": b.high_n_mm,
            }
            for b in bands
        ]
        self._props.update({"bands": drawn, "from": 1e3 * path_m[0], "to": 1e3 * path_m[1], "words": words})
        self.update()


class RigScene(PacedElement, component="rig_scene.js"):  # type: ignore[call-arg]
    def __init__(self, size: dict[str, float]) -> None:
        super().__init__()
        self._props.update(size=size, bead=0, words="stage, probe, ring and phantom from the side, to scale")
        self._last: dict[str, float] = {}

    def bead(self, depth_mm: float) -> None:
        """Show the bead so deep; 0: none is known."""
        if self._props["bead"] != depth_mm:
            self._props["bead"] = depth_mm
            self.update()

    def go(self, goal: dict[str, float]) -> None:
        """Move there, evenly until the next look."""
        if goal != self._last and not self.busy:
            self._last = goal
            self.send("go", goal, MOVE_MS)


class TouchPanel:
    """The sweep under way over what training taught, and the rig that makes it, drawn to scale."""

    def __init__(self, monitor: RigMonitor) -> None:
        self._monitor = monitor
        self._number, self._lean, self._behind = -1, 0.0, False
        self._swept_m: float | None = None
        with ui.element("section"):
            text_element("h2", "Torque of the present sweep, and what training taught")
            self._chart = SweepChart(monitor.path_m)
            self._taught = text_element("div", "", "quiet").props('data-what="taught"')
            text_element("h2", "The rig, to scale")
            self._facts = text_element("div", "", "rig-facts").props('data-what="rig"')
            self._size = lengths_mm(*monitor.path_m)
            self._scene = RigScene(self._size)

    def show(self, new: list[Point]) -> None:
        sweep, chart = self._monitor.sweep, self._chart
        self._behind = self._behind or sweep.number != self._number
        self._number = sweep.number
        if chart.busy:
            self._behind = self._behind or bool(new)
        elif self._behind:
            chart.send("begin", _drawn(sweep.points, MOST_POINTS))
            self._behind, self._swept_m = False, self._monitor.ring_m
            self._show_bands()
        elif new:
            chart.send("add", _drawn(new, FEW_POINTS))
        self._scene.go(self._pose(new))

    def _pose(self, new: list[Point]) -> dict[str, float]:
        monitor = self._monitor
        lift_mm = lift_of(monitor)
        touches = lift_mm < self._size["indentation"]
        if new and monitor.ring_m is not None:
            self._lean = lean_rad(new[-1][1] * 1e-3, monitor.ring_m)
        goal = {"lift": lift_mm, "lean": round(math.degrees(self._lean) if touches else 0.0, 2)}
        if monitor.position_m is not None:
            goal["y"] = round(1e3 * monitor.position_m, 2)
        if monitor.ring is not None:
            goal["ring"] = round(1e3 * monitor.ring["measured_m"], 2)
        return goal

    def show_text(self) -> None:
        self._show_bands()
        self._scene.bead(self._monitor.depth_mm)
        self._facts.text = rig_text(self._monitor)

    def _show_bands(self) -> None:
        """Show what training taught of the ring position of the sweep that is shown."""
        monitor = self._monitor
        ring_m = monitor.ring_m if self._swept_m is None else self._swept_m
        bands = monitor.bands(ring_m)
        self._taught.text = words = bands_text(bands, ring_m)
        self._chart.shape(bands, monitor.path_m, f"torque in N mm against stage position in mm. {words}")


def lengths_mm(from_m: float, to_m: float) -> dict[str, float]:
    """Return what the drawing needs, in mm; gel and probe as published, indentation as assumed."""
    probe = Probe()
    lengths_m = {
        "base": probe.base_m,
        "tip": probe.tip_m,
        "ball": probe.tip_radius_m,
        "pivot": probe.pivot_radius_m,
        "slab": Phantom().height_m,
        "bead": Bead(depth_m=0.002).radius_m,
        "indentation": StagePath().indentation_m,
        "from": from_m,
        "to": to_m,
        "lift": LIFT_M,
    }
    return {name: 1e3 * length_m for name, length_m in lengths_m.items()}


def lean_rad(torque_n_m: float, ring_m: float) -> float:
    """Return the angle of the tip link at rest by the torque at the sensor: the joint bears its share of it.

    The ball cannot lean further than to where it leaves the gel.
    """
    probe = Probe()
    farthest = math.acos(1.0 - StagePath().indentation_m / probe.lever_m)
    share = probe.lever_m / (probe.base_m + probe.lever_m)
    holds_n_m = probe.spring_n_m(ring_m) + probe.weight_n_m
    sine = torque_n_m * share / holds_n_m if holds_n_m > 0.0 else math.copysign(1.0, torque_n_m)
    return max(-farthest, min(farthest, math.asin(max(-1.0, min(1.0, sine)))))


def lift_of(monitor: RigMonitor) -> float:
    """Return how high the stage holds the probe in mm: as it reports, else as in a sweep or between two."""
    report = monitor.latest("StageReport")
    if report is not None and report["condition"] != Condition.CLOSED:  # a closed one measures nothing
        return round(1e3 * float(report["z_m"]), 2)
    return 0.0 if monitor.sweeping else 1e3 * LIFT_M


def bands_text(bands: list[Band], ring_m: float | None) -> str:
    if not bands or ring_m is None:
        return "no bands: training goes on, or has taught nothing of this ring position"
    counts = sorted({band.sweep_count for band in bands})
    of = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    spread = f"mean and two standard deviations of {of} sweeps of training"
    return f"bands: {spread} at each depth, ring at {1e3 * ring_m:g} mm"


def rig_text(monitor: RigMonitor) -> str:
    status, ring, mounted = monitor.status, monitor.ring, monitor.mounted
    parts = [f"stage: {status['status'] if status is not None else 'no status yet'}"]
    if ring is not None:
        does = "settled" if ring["settled"] else "re-homing" if ring["rehome"] else "moving"
        if not ring["settled"] and (report := monitor.latest("RingReport")) and report["text"]:
            does += f": {report['text']}"
        parts.append(f"ring: {1e3 * ring['measured_m']:.1f} mm, {does}")
    parts.append("phantom: not known yet" if mounted is None else f"phantom {mounted['code']}")
    return "; ".join(parts)


def _drawn(points: list[Point], most: int) -> Float64Array:
    """Return what is drawn of points: position in mm, torque in N mm, shape (n, 2)."""
    found: Float64Array = thinned(np.array(points, dtype=float).reshape(-1, 2), most).round(4)
    return found


class ShareBars(Element, component="bars.js"):  # type: ignore[misc, call-arg]
    def __init__(self, label: str) -> None:
        super().__init__()
        self._props.update(rows=[], words=label)

    def show(self, rows: list[dict[str, Any]]) -> None:
        if rows != self._props["rows"]:
            self._props["rows"] = rows
            self.update()


class BeliefPanel:
    """The belief of the present trial: posterior as bars, gain and entropy over its palpations."""

    def __init__(self, source: ViewSource, monitor: RigMonitor) -> None:
        self._source, self._monitor = source, monitor
        self._shown = [JudgedProbe(-1, 0.0, 0.0)]
        text_element("h2", "The present trial")
        self._text = text_element("div", "").props('data-what="trial" role="status"')
        self._policy = text_element("div", "", "quiet").props('data-what="policy"')
        self._bars = ShareBars("how probable each depth is")
        text_element("h2", "Gain and entropy over its palpations")
        self._box = ui.element("div").props('data-what="probes"')

    def show(self) -> None:
        belief = self._monitor.belief
        self._text.text = trial_text(belief, self._monitor.latest("Progress"))
        policy = self._policy_class()
        self._policy.text = f"policy: {policy}" if policy else ""
        self._bars.show(bars(belief))
        if belief.probes == self._shown:
            return
        self._shown = list(belief.probes)
        self._box.clear()
        with self._box:
            if not belief.probes:
                text_element("div", "no palpation of it is judged yet", "quiet")
                return
            most = max(1.0, *(probe.gain_bits for probe in belief.probes), belief.probes[0].entropy_bits)
            rows = (
                (
                    str(probe.iteration),
                    partial(_part, probe.gain_bits, most),
                    partial(_part, probe.entropy_bits, most),
                )
                for probe in belief.probes
            )
            table(("Palpation", "Gain, bits", "Entropy, bits"), rows)

    def _policy_class(self) -> str:
        """Return the class that chooses now; "" over a bag, which has that of its begin only."""
        node, overview = node_of(self._monitor.topics.get("PolicyChange", "")), self._source.overview()
        runs = {one.name: one.run for one in overview.nodes} if overview.kind == "graph" else {}
        return runs.get(node, "")


def _part(bits: float, most: float) -> None:
    with ui.element("span").classes("rig-part"):
        text_element("span", f"{bits:.2f}")
        width = f"width: {80 * bits / most:.1f}%"
        ui.element("span").classes("rig-bar").style(f"{width}; background: var(--accent)")


def bars(belief: TrialBelief) -> list[dict[str, Any]]:
    most = max(belief.posterior, default=0.0)
    return [
        {"label": f"{depth_mm:g} mm", "share": round(p, 4), "text": f"{100 * p:.1f} %", "most": p == most}
        for depth_mm, p in zip(belief.depths_mm, belief.posterior, strict=False)
    ]


def trial_text(belief: TrialBelief, progress: dict[str, Any] | None) -> str:
    parts = []
    if progress is not None:
        what = "palpation" if progress["phase"] == "training" else "trial"
        phase = "the session is over" if progress["phase"] == "done" else progress["phase"]
        parts.append(f"{phase}: {progress['done_count']} of {progress['total_count']} {what}s done")
    if belief.estimating and belief.probes:
        count_text = f"{counted(len(belief.probes), 'palpation')} of this trial"
        parts.append(f"{count_text}, {belief.verdict}" if belief.verdict != "continue" else count_text)
    if belief.within_sweep:
        parts.append("believed within the sweep")
    return "; ".join(parts) or "no trial yet"


class MusclePanel:
    """EMG and co-contraction, where the graph has them."""

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
            latest, now_s = self._monitor.latest, self._source.overview().now_s
            fast = self._monitor.at_once
            self._text.text = muscle_text(latest("CoContraction"), latest("EmgReport"), now_s, fast=fast)


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
            level, place = LEVELS[cocontraction["level"]]
            parts.append(f"level {level:g} at its latest peak ({place} of five)")
        else:
            parts.append("no peak yet, so no level")
        parts.append(counted(cocontraction["burst_count"], "burst"))
        if now_s is not None:
            last_s = cocontraction["stamp_ns"] / 1e9
            if now_s - last_s > (SILENT_FAST_S if fast else SILENT_S):
                parts.append(f"silent since {last_s:.0f} s on the graph's clock")
    if report is not None:
        if report["condition"] not in FLOWING:
            parts.append(": ".join(part for part in (report["condition"], report["text"]) if part))
        elif cocontraction is None:
            parts.append("EMG comes; no co-contraction yet")
    return "; ".join(parts) or "no EMG yet"


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
            one.set_visibility(False)  # axes without a point show nothing
        waiting = [NO_POINTS for _ in series]
        seen = [-1]

        def tick() -> None:
            samples = _last_new(watch, seen) if last_only else watch.read_new()
            for place, field in enumerate(series):
                points = np.concatenate([waiting[place], *(field.add(message) for message in samples)])
                waiting[place] = shown(points, SPAN_S)
            if any(len(points) for points in waiting) and not plot.busy:
                for one in (plot, along):
                    one.set_visibility(True)
                plot.add(waiting)
                waiting[:] = [NO_POINTS for _ in series]

        ui.timer(PLOT_S, tick)


def _last_new(watch: Watch, seen: list[int]) -> list[Sample]:
    """Return the last message, if it is not shown already."""
    last = watch.latest()
    if last is None or last.sequence == seen[0]:
        return []
    seen[0] = last.sequence
    return [last]


class OutcomePanel:
    """Trials with their verdicts, accuracy, guards met: made again when something has come."""

    def __init__(self, source: ViewSource, monitor: RigMonitor) -> None:
        self._source, self._monitor = source, monitor
        self._shown: list[TrialRow] | None = None
        self._guards: list[str] | None = []
        self._has_results = False
        with ui.element("div").classes("rig-grid"):
            with ui.element("section"):
                text_element("h2", "Trials so far, the latest first")
                self._trials = ui.element("div").classes("rig-scroll").props('data-what="trials"')
            with ui.element("section"):
                text_element("h2", "Right so far")
                self._right = ui.element("div").props('data-what="right"')
                if monitor.has("ContactGuard"):
                    text_element("h2", "Guards met")
                    self._met = ui.element("div").props('data-what="guards"')
        self._where = ui.element("p").classes("quiet").props('data-what="results"')

    def show(self) -> None:
        rows = self._monitor.board.rows
        if rows != self._shown:
            self._shown = list(rows)
            titles = ("Trial", "Phantom", "True depth", "Found", "Sure", "Palpations", "Verdict", "")
            with refilled(self._trials):
                latest_rows(titles, [_trial_cells(row) for row in rows])
            with refilled(self._right):
                self._accuracy()
        if self._monitor.has("ContactGuard") and self._guards != self._monitor.guards:
            self._guards = self._monitor.guards
            with refilled(self._met):
                _guards(self._guards)
        if not self._has_results and (folder := session_folder(self._source, self._monitor.topics)):
            self._has_results = True
            with refilled(self._where):
                _results(folder)

    def _accuracy(self) -> None:
        board = self._monitor.board
        overall = board.accuracy()
        if overall is None:
            text_element("div", "no trial is judged yet", "quiet")
            return
        rows = [(f"{depth:g} mm", *_share(one)) for depth, one in board.by_depth().items()]
        titles = ("Depth", "Right", "Of", "Share (95 %, this session only)")
        table(titles, [*rows, ("all", *_share(overall))])
        if mixed := board.mixed_text():
            text_element("p", mixed)
        advice = "Phantoms come in blocks: the share of all depends on whose block it is; look at each depth."
        text_element("p", advice, "quiet")


def refilled(box: ui.element) -> Any:
    """Return an element, emptied, to put something into."""
    box.clear()
    return box


def latest_rows(titles: Iterable[str], rows: list[tuple[Cell, ...]]) -> None:
    """Show the last rows of trials, the latest first."""
    if not rows:
        text_element("div", "no trial is over yet", "quiet")
        return
    table(list(titles), rows[: -MOST_ROWS - 1 : -1])
    if len(rows) > MOST_ROWS:
        text_element("div", f"and {len(rows) - MOST_ROWS} before", "quiet")


def _results(folder: Path) -> None:
    text_element("span", "The record grows as the session goes on; its report is there at the end: ")
    text_element("code", str(folder / "report.html"))


def _share(one: Proportion) -> tuple[str, str, str]:
    share = f"{100 * one.value:.1f} % ({100 * one.low:.0f} to {100 * one.high:.0f})"
    return str(one.success_count), str(one.trial_count), share


def _trial_cells(row: TrialRow) -> tuple[Cell, ...]:
    found = row.verdict != "dropped"
    verdict = "" if row.right is None else "right" if row.right else "wrong"
    return (
        str(row.number),
        row.code,
        "" if row.depth_mm is None else f"{row.depth_mm:g} mm",
        f"{row.estimate_mm:g} mm" if found else "",
        f"{100 * row.confidence:.0f} %" if found else "",
        str(row.probe_count),
        row.verdict,
        partial(text_element, "span", verdict, verdict) if verdict else "",
    )


def _guards(guards: list[str] | None) -> None:
    if not guards:
        none = "none: the simulated touch is within the bounds of its model"
        text_element("div", "none reported yet" if guards is None else none, "quiet")
        return
    with ui.element("ul").classes("rig-notes"):
        for one in guards[:MOST_GUARDS]:
            text_element("li", one)
    if len(guards) > MOST_GUARDS:
        text_element("div", f"and {len(guards) - MOST_GUARDS} before", "quiet")
