"""Pictures of what was measured."""

from __future__ import annotations

import statistics
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from wire_bench.figures import TARGETS, Results

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

__all__ = ["jitter_chart", "wires_chart"]

COLOURS = {
    "palp": "#0072b2",
    "raw": "#999999",
    "raw_timeout": "#555555",
    "raw_three": "#cccccc",
    "zenoh": "#009e73",
    "ros2": "#d55e00",
    "ezmsg": "#cc79a7",
    "iceoryx2": "#e69f00",
}
LABELS = {
    "raw": "raw pyzmq + msgpack",
    "raw_timeout": "the same, receive timeout",
    "raw_three": "raw pyzmq, three frames",
    "ros2": "ROS 2 (rclpy)",
}
TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
CURVES = {"latency": "48 B, 1 kHz", "64k": "64 KiB, 100 Hz", "fan": "48 B, 1 kHz, five readers"}


def wires_chart(results: Results, path: Path) -> None:
    """Draw latency distributions beside each other, and every round's ratio with its target."""
    drawn = [measure for measure in CURVES if measure in results.latencies_s.get("palp", {})]
    figure, axes = plt.subplots(
        1, len(drawn) + 1, figsize=(4.2 * (len(drawn) + 1), 3.8), layout="constrained", squeeze=False
    )
    for axis, measure in zip(axes[0], drawn, strict=False):
        for contender, kept in results.latencies_s.items():
            if measure not in kept:
                continue
            times_us = np.sort(np.concatenate(kept[measure])) * 1e6
            beyond = 1.0 - np.arange(times_us.size) / times_us.size
            axis.loglog(times_us, beyond, color=COLOURS[contender], label=LABELS.get(contender, contender))
        axis.set(title=CURVES[measure], xlabel="one-way latency, µs", ylabel="share of messages above")
        axis.grid(alpha=0.3)
    if drawn:
        axes[0][0].legend(frameon=False, fontsize=8)
    peers = [name for name in results.rounds if name != "palp"]
    if peers:
        peer = "raw" if "raw" in peers else peers[0]
        _ratios(axes[0][-1], results.ratios(peer), peer)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _ratios(axis: Axes, ratios: dict[str, list[float]], peer: str) -> None:
    for row, (name, values) in enumerate(ratios.items()):
        axis.plot(values, [row] * len(values), "o", color=COLOURS["palp"], alpha=0.4, markersize=4)
        axis.plot(
            statistics.median(values), row, "|", color=COLOURS["palp"], markersize=16, markeredgewidth=2
        )
        target = TARGETS.get(peer, {}).get(name)
        if target is not None:
            axis.plot(target, row, "x", color="black", markersize=6)
    axis.axvline(1.0, color="black", linewidth=0.6)
    axis.set_yticks(range(len(ratios)), [name.removesuffix("_ratio") for name in ratios], fontsize=8)
    axis.set(title=f"palp over {LABELS.get(peer, peer)}, by round (x: target)", xscale="log")
    axis.set_xticks([tick for tick in TICKS if axis.get_xlim()[0] <= tick <= axis.get_xlim()[1]])
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.xaxis.set_minor_formatter("")
    axis.grid(alpha=0.3, axis="x", which="both")
    axis.invert_yaxis()


def jitter_chart(late_ns: NDArray[np.int64], path: Path, seconds: float) -> None:
    """Draw how late the ticks of the 1 kHz timer begin."""
    late_us = np.maximum(late_ns / 1e3, 1.0)
    figure, axis = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    axis.hist(
        late_us,
        bins=np.geomspace(1.0, max(late_us.max(), 2000.0), 120).tolist(),
        color=COLOURS["palp"],
        log=True,
    )
    axis.axvline(1000.0, color="black", linewidth=0.8, linestyle="--")
    axis.text(1000.0, 0.98, " next tick due", transform=axis.get_xaxis_transform(), va="top", fontsize=8)
    axis.set(xscale="log", xlabel="lateness of a tick, µs", ylabel="ticks")
    axis.set_title(f"1 kHz timer over {seconds:g} s: {late_ns.size} ticks, {(late_ns >= 1e6).sum()} overruns")
    axis.grid(alpha=0.3)
    figure.savefig(path, dpi=150)
    plt.close(figure)
