"""Draw a checked graph: as Mermaid text for documents, as a PNG for the eye."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.layout import GAP_X, HEAD, LANE, WIDTH, Box, Layout, Wire, arrange

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRUTH = "truth"
_INK, _PAPER = "#222222", "#fbfbf9"
_COLOURS = (
    "#1b6ca8",
    "#b3541e",
    "#2f7d4f",
    "#7a4fa3",
    "#a8324a",
    "#5f6b0f",
    "#0f7b83",
    "#8a5a2b",
    "#46529e",
    "#99406f",
)
_MOVE, _LINE, _QUADRATIC, _CUBIC = 1, 2, 3, 4  # matplotlib's path codes
_INCHES = 0.62
_TURN = 0.16


def wires_of(graph: CheckedGraph) -> list[Wire]:
    """Return one wire per input; that of a client runs from the client to the service."""
    wires = []
    for spec in graph.nodes:
        for port, source in spec.inputs.items():
            node, _, output = source.removeprefix("/").partition("/")
            if [node, output] in graph.edges.get(f"/{spec.name}/{port}", []):
                wires.append(Wire(spec.name, port, node, output))
            else:
                wires.append(Wire(node, output, spec.name, port, truth=output == _TRUTH))
    return wires


def mermaid(graph: CheckedGraph) -> str:
    """Return a flow chart as Mermaid text; wires that carry the truth are dashed."""
    lines = ["flowchart LR"]
    lines += [f'    {s.name}("<b>{s.name}</b><br/>{s.run.rpartition(":")[2]}")' for s in graph.nodes]
    for wire in wires_of(graph):
        arrow = "-.->" if wire.truth else "-->"
        lines.append(f'    {wire.source} {arrow}|"{wire.port}"| {wire.target}')
    return "\n".join(lines) + "\n"


def draw_png(graph: CheckedGraph, path: Path) -> None:
    """Draw a graph into a PNG file.

    Each box has its inputs on the left and its outputs on the right. A wire has its publisher's colour, is
    dashed where it carries the truth, and runs below the boxes where it goes back to the left.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wires = wires_of(graph)
    layout = arrange([spec.name for spec in graph.nodes], wires)
    boxes = layout.boxes
    back = [wire for wire in wires if boxes[wire.source].layer >= boxes[wire.target].layer]
    lanes = _lanes(back, boxes)
    top = max(box.y for box in boxes.values())
    floor = min([box.y - box.height for box in boxes.values()] + list(layout.passes.values()))
    right = max(box.x for box in boxes.values()) + WIDTH
    low, high = floor - LANE * (len(lanes) + 2), top + 1.0
    figure = Figure(figsize=(_INCHES * (right + 2.4), _INCHES * (high - low)), dpi=160)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-1.2, right + 1.2), ylim=(low, high))
    axes.set_axis_off()
    axes.text(0.0, top + 0.55, graph.graph, fontsize=12, fontweight="bold", color=_INK, va="center")
    colours = {spec.name: _COLOURS[i % len(_COLOURS)] for i, spec in enumerate(graph.nodes)}
    for wire in wires:
        points = _back(wire, boxes, lanes, floor) if wire in back else _forward(wire, layout)
        _draw_wire(axes, points, colours[wire.source], wire.truth, straight=wire in back)
    for spec in graph.nodes:
        _draw_box(axes, boxes[spec.name], spec.run.rpartition(":")[2], colours[spec.name])
    figure.savefig(path, format="png", facecolor="white")


_Points = list[tuple[float, float]]


def _lanes(back: list[Wire], boxes: dict[str, Box]) -> dict[tuple[str, str], int]:
    """Give each output whose wires go back a lane below the boxes; short ones run nearest to the boxes."""

    def span(net: tuple[str, str]) -> float:
        return max(boxes[net[0]].layer - boxes[w.target].layer for w in back if (w.source, w.port) == net)

    nets = dict.fromkeys((wire.source, wire.port) for wire in back)
    return {net: i for i, net in enumerate(sorted(nets, key=span))}


def _forward(wire: Wire, layout: Layout) -> _Points:
    source, target = layout.boxes[wire.source], layout.boxes[wire.target]
    points = [(source.x + WIDTH, source.port_y(source.outputs, wire.port))]
    for layer in range(source.layer + 1, target.layer):
        x, y = layer * (WIDTH + GAP_X), layout.passes[wire.source, wire.port, layer]
        points += [(x, y), (x + WIDTH, y)]
    return [*points, (target.x, target.port_y(target.inputs, wire.input))]


def _back(wire: Wire, boxes: dict[str, Box], lanes: dict[tuple[str, str], int], floor: float) -> _Points:
    source, target = boxes[wire.source], boxes[wire.target]
    lane = lanes[wire.source, wire.port]
    y = floor - LANE * (lane + 1.2)
    out = source.x + WIDTH + 0.2 + (GAP_X - 0.4) * (lane + 1) / (len(lanes) + 1)
    into = target.x - 0.2 - (GAP_X - 0.4) * (lane + 1) / (len(lanes) + 1)
    start, end = source.port_y(source.outputs, wire.port), target.port_y(target.inputs, wire.input)
    return [(source.x + WIDTH, start), (out, start), (out, y), (into, y), (into, end), (target.x, end)]


def _draw_wire(axes: Axes, points: _Points, colour: str, truth: bool, *, straight: bool) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path as Curve

    vertices, codes = _rounded(points) if straight else _smooth(points)
    arrow = FancyArrowPatch(
        path=Curve(vertices, codes),
        arrowstyle="-|>",
        mutation_scale=9,
        shrinkA=0,
        shrinkB=0,
        color=colour,
        linewidth=1.3,
        linestyle=(0, (4, 2.5)) if truth else "-",
        zorder=1,
    )
    axes.add_patch(arrow)


def _smooth(points: _Points) -> tuple[_Points, list[int]]:
    """Return Bezier curves that leave and arrive level; every second stretch passes a layer straight."""
    vertices, codes = points[:1], [_MOVE]
    for i, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(points)):
        if i % 2:
            vertices.append((x1, y1))
            codes.append(_LINE)
        else:
            middle = (x0 + x1) / 2
            vertices += [(middle, y0), (middle, y1), (x1, y1)]
            codes += [_CUBIC] * 3
    return vertices, codes


def _rounded(points: _Points) -> tuple[_Points, list[int]]:
    """Return straight stretches with rounded corners."""
    vertices, codes = points[:1], [_MOVE]
    for (x0, y0), (x1, y1), (x2, y2) in zip(points, points[1:], points[2:], strict=False):
        before, after = abs(x1 - x0) + abs(y1 - y0), abs(x2 - x1) + abs(y2 - y1)
        r0, r1 = min(_TURN, before / 2) / max(before, 1e-9), min(_TURN, after / 2) / max(after, 1e-9)
        vertices += [
            (x1 + (x0 - x1) * r0, y1 + (y0 - y1) * r0),
            (x1, y1),
            (x1 + (x2 - x1) * r1, y1 + (y2 - y1) * r1),
        ]
        codes += [_LINE, _QUADRATIC, _QUADRATIC]
    return [*vertices, points[-1]], [*codes, _LINE]


def _draw_box(axes: Axes, box: Box, class_name: str, colour: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    bottom = box.y - box.height
    axes.add_patch(
        FancyBboxPatch(
            (box.x + 0.1, bottom + 0.1),
            WIDTH - 0.2,
            box.height - 0.2,
            boxstyle="round,pad=0.1,rounding_size=0.14",
            facecolor=_PAPER,
            edgecolor=colour,
            linewidth=1.6,
            zorder=2,
        )
    )
    left, centre, right = box.x + 0.1, box.x + WIDTH / 2, box.x + WIDTH - 0.1

    def write(
        x: float, y: float, text: str, side: str, size: float, ink: str, weight: str = "normal"
    ) -> None:
        axes.text(x, y, text, ha=side, va="center", fontsize=size, color=ink, fontweight=weight, zorder=3)

    write(centre, box.y - 0.22, box.name, "center", 9.5, _INK, "bold")
    write(centre, box.y - 0.48, class_name, "center", 7.0, "#666666")
    for port in box.inputs:
        write(left, box.port_y(box.inputs, port), port, "left", 7.0, _INK)
    for port in box.outputs:
        write(right, box.port_y(box.outputs, port), port, "right", 7.0, colour)
    if box.inputs or box.outputs:
        axes.hlines(box.y - HEAD + 0.02, left, right, color=colour, linewidth=0.5, alpha=0.5, zorder=3)
