"""Tables for a terminal."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from wire_bench.figures import OWN, RATIOS, Results

__all__ = ["show_wires"]

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


def _ratio_cells(name: str, stated: dict[str, Any] | None) -> tuple[str, str, str]:
    """Return median, spread and target of a ratio."""
    if stated is None:
        return "", "", ""
    spread = f"{stated['least']:.2f} to {stated['largest']:.2f}"
    return f"{stated['median']:.2f}", spread, _verdict(name, stated["median"], stated["target"])


def _rows(found: dict[str, Any], measure: str, figure: str) -> list[tuple[str, ...]]:
    """Return a row for each contender that has this figure, or a ratio of palp's to another of its own."""
    rows = []
    of = [n for n, ratio in (RATIOS | OWN).items() if (ratio.measure, ratio.figure) == (measure, figure)]
    for contender, measures in found["absolute"].items():
        cells = ["", "", ""]
        if figure in measures.get(measure, {}):
            ends = (found[f"absolute_{end}"][contender][measure][figure] for end in ("least", "largest"))
            cells = [
                _figure(figure, measures[measure][figure]),
                " to ".join(_figure(figure, end) for end in ends),
                str(found["rounds_of"][contender][measure]),
            ]
        ratios = {} if contender == "palp" else found["ratios"].get(contender, {})
        name = next((name for name in of if name in ratios), "")
        if cells[0] or name:
            rows.append((contender, *cells, *_ratio_cells(name, ratios.get(name))))
    own = found["ratios"].get("palp", {})
    rows.extend(("palp's own trip", "", "", "", *_ratio_cells(name, own[name])) for name in of if name in own)
    return rows


def show_wires(console: Console, results: Results, found: dict[str, Any]) -> None:
    """Print one table: every figure of every contender, palp over it, and the targets."""
    title = f"palp's wires and others', {found['rounds']} rounds, the order turned from round to round"
    columns = ("measure", "contender", "median", "least to largest", "rounds")
    over = ("palp over it", "least to largest", "target")
    table = Table(*columns, *over, title=title, box=SIMPLE_HEAD)
    for measure in results.rounds.get("palp", {}):
        for figure in results.rounds["palp"][measure][0]:
            for at, row in enumerate(_rows(found, measure, figure)):
                unit = figure.removesuffix("_s").removesuffix("_hz")
                table.add_row(f"{measure} {unit}" if at == 0 else "", *row)
            table.add_section()
    if table.rows:
        console.print(table)
    for name, about in found["contenders"].items():
        version = found["versions"].get(name, "")
        console.print(f"{name}: {about}{f' ({version})' if version else ''}", highlight=False)
    for name, reason in found["left_out"].items():
        console.print(f"[red]{name} is left out[/red]: {escape(reason)}", highlight=False)
    if results.startup_s:
        took_s = found["startup_10_nodes_s"]
        kept = _verdict("startup", took_s, STARTUP_TARGET_S)
        console.print(f"ten nodes, from command to first message at the end: {took_s:.2f} s ({kept})")
    lost = ", ".join(f"{name} {count}" for name, count in found["lost_by_contender"].items())
    console.print(f"lost: {lost or 'nothing'}; machine: {found['machine']}")
