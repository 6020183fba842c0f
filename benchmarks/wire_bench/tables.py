"""Tables for a terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table
from wire_bench.figures import RATIOS, Results

__all__ = ["show_steady", "show_wires"]

STARTUP_TARGET_S = 1.0


def _figure(name: str, value: float) -> str:
    return f"{value:,.0f} Hz" if name == "rate_hz" else f"{value * 1e6:.0f} µs"


def _verdict(name: str, value: float, target: float | None) -> str:
    if target is None:
        return ""
    low = name.startswith("rate")
    kept = value >= target if low else value <= target
    text = f"{'>=' if low else '<='} {target:g}"
    return f"[green]{text}[/green]" if kept else f"[red]{text}[/red]"


def show_wires(console: Console, results: Results, found: dict[str, Any]) -> None:
    """Print ratios, then absolute figures."""
    title = f"palp's wires, {found['rounds']} rounds"
    table = Table("ratio to raw pyzmq", "median", "spread", "target", title=title)
    for name, (low, high) in found["spread"].items():
        table.add_row(
            name,
            f"{found[name]:.2f}",
            f"{low:.2f} to {high:.2f}",
            _verdict(name, found[name], RATIOS[name][2]),
        )
    if table.rows:
        console.print(table)
    table = Table("measure", "figure", *found["absolute"], title="absolute, medians of rounds")
    for measure in results.rounds.get("palp", {}):
        for figure in results.rounds["palp"][measure][0]:
            cells = [_figure(figure, of[measure][figure]) for of in found["absolute"].values()]
            table.add_row(measure, figure, *cells)
    if table.rows:
        console.print(table)
    if results.startup_s:
        took_s = found["startup_10_nodes_s"]
        kept = _verdict("startup", took_s, STARTUP_TARGET_S)
        console.print(f"ten nodes, from command to first message at the end: {took_s:.2f} s ({kept})")
    lost = ", ".join(f"{name} {count}" for name, count in found["lost_by_contender"].items())
    console.print(f"lost: {lost or 'nothing'}; machine: {found['machine']}")


def show_steady(console: Console, found: dict[str, Any]) -> None:
    """Print the long run."""
    table = Table("timer of", "ticks", "overruns", "%", "late p50", "p99", "p99.9", "max")
    for node, timer in found["timers"].items():
        times = [f"{timer[f'late_{name}_us']:.0f} µs" for name in ("p50", "p99", "p99_9", "max")]
        row = (str(timer["ticks"]), str(timer["overruns"]), f"{timer['overruns_percent']:.4f}", *times)
        table.add_row(node, *row)
    console.print(table)
    table = Table("process", "memory", "grown", "slope", "of a core")
    for node, process in found["processes"].items():
        table.add_row(
            node,
            f"{process['rss_mib']:.1f} MiB",
            f"{process['grown_kib']:.0f} KiB",
            f"{process['kib_per_min']:.1f} KiB/min",
            f"{process['core_share']:.0%}",
        )
    console.print(table)
    console.print(f"sent {found['sent']} in {found['seconds']:g} s, lost {found['lost']}")
