"""Draw what was asked for and what came of it."""

from __future__ import annotations

import csv
from pathlib import Path

from msgs.pendulum import Motion, Reference
from palp_core import Node, Params, State, Sub, on
from palp_core.units import Radians, Seconds


class PlotParams(Params):
    """Where to: a folder, from where you are."""

    out: str = "pendulum"


class PlotState(State):
    """What a replacement inherits: all that is to be drawn."""

    reference_rad: Radians = 0.0
    rows: list[tuple[Seconds, Radians, Radians]] = []


class Plot(Node):
    """Gather angles; when the run ends, write ``pendulum.csv``, and ``pendulum.png`` where matplotlib is."""

    params: PlotParams
    state: PlotState
    reference = Sub(Reference)
    motion = Sub(Motion)

    @on(reference)
    def note(self, reference: Reference) -> None:
        self.state.reference_rad = reference.angle_rad

    @on(motion)
    def gather(self, motion: Motion) -> None:
        self.state.rows.append((motion.stamp_ns / 1e9, self.state.reference_rad, motion.angle_rad))

    def on_shutdown(self) -> None:
        folder = Path(self.params.out)
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "pendulum.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("time_s", "reference_rad", "angle_rad"))
            writer.writerows(self.state.rows)
        try:
            from matplotlib.figure import Figure
        except ModuleNotFoundError:
            self.log.info("no picture without matplotlib; the table is in %s", folder)
            return
        figure = Figure(figsize=(8.0, 3.5), layout="constrained")
        axes = figure.subplots()
        time_s, reference_rad, angle_rad = (
            zip(*self.state.rows, strict=True) if self.state.rows else ((),) * 3
        )
        axes.step(time_s, reference_rad, where="post", color="0.6", label="asked for")
        axes.plot(time_s, angle_rad, label="came of it")
        axes.set(xlabel="time, s", ylabel="angle from upright, rad")
        axes.legend()
        figure.savefig(folder / "pendulum.png", dpi=120)
