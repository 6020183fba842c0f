"""The sweep under way over what training taught, and the rig that makes it, drawn to scale and moving."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.elements.echart import EChart  # its import is what makes ECharts known to the page

from palp_core.palpation.devices.health import Condition
from palp_core.palpation.live_page.geometry import LIFT_M, lean_rad, lengths_mm
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.palpation.live_page.sweep import Point
from palp_core.palpation.live_page.taught import Band
from palp_core.units import Float64Array
from palp_core.view.pages.parts import PacedElement, text_element
from palp_core.view.source.series import thinned

__all__ = ["EChart", "TouchPanel"]

MOST_POINTS = 600
"""Of a whole sweep: more than a chart has columns of pixels."""
FEW_POINTS = 60
"""Of a twentieth of a second."""
MOVE_MS = 60
"""Between two looks the drawing moves evenly."""


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
                "label": f"{band.depth_mm:g} mm deep",
                "places": band.places_mm,
                "low": band.low_n_mm,
                "high": band.high_n_mm,
            }
            for band in bands
        ]
        self._props.update({"bands": drawn, "from": 1e3 * path_m[0], "to": 1e3 * path_m[1], "words": words})
        self.update()

    def begin(self, points: list[Point]) -> None:
        self.send("begin", _drawn(points, MOST_POINTS))

    def add(self, points: list[Point]) -> None:
        self.send("add", _drawn(points, FEW_POINTS))


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
            chart.begin(sweep.points)
            self._behind, self._swept_m = False, self._monitor.ring_m
            self._show_bands(chart)
        elif new:
            chart.add(new)
        self._scene.go(self._pose(new))

    def _pose(self, new: list[Point]) -> dict[str, float]:
        monitor = self._monitor
        ring, lift_mm = monitor.ring, lift_of(monitor)
        touches = lift_mm < self._size["indentation"]
        if new and monitor.ring_m is not None:
            self._lean = lean_rad(new[-1][1] * 1e-3, monitor.ring_m)
        goal = {"lift": lift_mm, "lean": round(math.degrees(self._lean) if touches else 0.0, 2)}
        if monitor.position_m is not None:
            goal["y"] = round(1e3 * monitor.position_m, 2)
        if ring is not None:
            goal["ring"] = round(1e3 * ring["measured_m"], 2)
        return goal

    def show_text(self) -> None:
        self._show_bands(self._chart)
        self._scene.bead(self._monitor.depth_mm)
        self._facts.text = rig_text(self._monitor)

    def _show_bands(self, chart: SweepChart) -> None:
        """Show what training taught of the ring position of the sweep that is shown."""
        monitor = self._monitor
        ring_m = monitor.ring_m if self._swept_m is None else self._swept_m
        bands = monitor.bands(ring_m)
        self._taught.text = words = bands_text(bands, ring_m)
        chart.shape(bands, monitor.path_m, f"torque in N mm against stage position in mm. {words}")


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
    status, ring = monitor.status, monitor.ring
    parts = [f"stage: {status['status']}" if status is not None else "stage: nothing heard yet"]
    if ring is not None:
        does = "settled" if ring["settled"] else "re-homing" if ring["rehome"] else "moving"
        if not ring["settled"] and (report := monitor.latest("RingReport")) and report["text"]:
            does += f": {report['text']}"
        parts.append(f"ring: {1e3 * ring['measured_m']:.1f} mm, {does}")
    if monitor.mounted is None:
        parts.append("phantom: nobody has told yet")
    else:
        parts.append(f"phantom {monitor.mounted['code']}")
    return "; ".join(parts)


def _drawn(points: list[Point], most: int) -> Float64Array:
    """Return what is drawn of points: position in mm, torque in N mm, shape (n, 2)."""
    found: Float64Array = thinned(np.array(points, dtype=float).reshape(-1, 2), most).round(4)
    return found
