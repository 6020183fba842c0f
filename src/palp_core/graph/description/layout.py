"""Place the nodes of a graph in layers from left to right, with room between them for passing wires.

The classic three steps (Sugiyama, Tagawa and Toda 1981): turn a few wires round so that no loop is left (the
greedy rule of Eades, Lin and Smyth 1993), put each node one layer right of its last publisher, then order
every
layer by the mean place of its neighbours. Ties keep the file's order: the same graph always looks the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

WIDTH, GAP_X, GAP_Y, ROW, HEAD, LANE = 2.7, 1.3, 0.4, 0.27, 0.66, 0.26
_SWEEPS = 12


@dataclass(frozen=True)
class Wire:
    """From an output to an input."""

    source: str
    port: str
    target: str
    input: str
    truth: bool = False


@dataclass
class Box:
    """A node's place: x and y are its upper left corner, y upward, in units of the drawing."""

    name: str
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    layer: int = 0
    x: float = 0.0
    y: float = 0.0

    @property
    def height(self) -> float:
        return HEAD + ROW * max(len(self.inputs), len(self.outputs)) + 0.08

    def port_y(self, ports: list[str], name: str) -> float:
        """Return the height of a port's row."""
        return self.y - HEAD - ROW * (ports.index(name) + 0.5)


@dataclass(frozen=True)
class Layout:
    """Where everything is.

    Attributes:
        boxes: By node.
        passes: Height at which the wires of an output cross a layer, by (node, port, layer).
    """

    boxes: dict[str, Box]
    passes: dict[tuple[str, str, int], float]


_Slot = str | tuple[str, str, int]


def arrange(names: Sequence[str], wires: Sequence[Wire]) -> Layout:
    """Place nodes so that most wires run to the right."""
    boxes = {name: Box(name) for name in names}
    for wire in wires:
        for ports, port in ((boxes[wire.source].outputs, wire.port), (boxes[wire.target].inputs, wire.input)):
            if port not in ports:
                ports.append(port)
    rank = {name: i for i, name in enumerate(_without_loops(names, {(w.source, w.target) for w in wires}))}
    forward = [wire for wire in wires if rank[wire.source] < rank[wire.target]]
    for name in sorted(names, key=rank.__getitem__):
        boxes[name].layer = max((boxes[w.source].layer + 1 for w in forward if w.target == name), default=0)
    layers, links = _slots(boxes, forward)
    _order(layers, links)
    centres = _heights(boxes, layers, links)
    for box in boxes.values():
        box.x, box.y = box.layer * (WIDTH + GAP_X), centres[box.name] + box.height / 2
    passes = {slot: y for slot, y in centres.items() if not isinstance(slot, str)}
    _order_ports(boxes, wires, passes)
    return Layout(boxes, passes)


def _order_ports(
    boxes: dict[str, Box], wires: Sequence[Wire], passes: dict[tuple[str, str, int], float]
) -> None:
    """Order outputs and then inputs by where their wires come from and go to; what runs below comes last."""

    def there(wire: Wire) -> float:
        source, target = boxes[wire.source], boxes[wire.target]
        if source.layer >= target.layer:
            return math.inf
        return -passes.get((wire.source, wire.port, source.layer + 1), target.y - target.height / 2)

    def here(wire: Wire) -> float:
        source, target = boxes[wire.source], boxes[wire.target]
        if source.layer >= target.layer:
            return math.inf
        straight = source.port_y(source.outputs, wire.port)
        return -passes.get((wire.source, wire.port, target.layer - 1), straight)

    for name, box in boxes.items():
        going = {
            port: min(there(w) for w in wires if (w.source, w.port) == (name, port)) for port in box.outputs
        }
        box.outputs.sort(key=going.__getitem__)
    for name, box in boxes.items():
        coming = {
            port: min(here(w) for w in wires if (w.target, w.input) == (name, port)) for port in box.inputs
        }
        box.inputs.sort(key=coming.__getitem__)


def _without_loops(names: Sequence[str], edges: set[tuple[str, str]]) -> list[str]:
    """Return the nodes in an order that few edges go against."""
    left: list[str] = []
    right: list[str] = []
    rest = list(names)
    edges = {(a, b) for a, b in edges if a != b}
    while rest:
        outs = {name: sum(a == name and b in rest for a, b in edges) for name in rest}
        ins = {name: sum(b == name and a in rest for a, b in edges) for name in rest}
        sink = next((name for name in rest if outs[name] == 0), None)
        source = next((name for name in rest if ins[name] == 0), None)
        if source is not None:
            left.append(source)
        elif sink is not None:
            right.insert(0, sink)
        else:
            left.append(max(rest, key=lambda name: outs[name] - ins[name]))
        rest.remove(left[-1] if source is not None or sink is None else right[0])
    return left + right


def _slots(
    boxes: dict[str, Box], forward: Sequence[Wire]
) -> tuple[list[list[_Slot]], list[tuple[_Slot, _Slot]]]:
    """Return the slots of each layer, and the links between slots of neighbouring layers."""
    layers: list[list[_Slot]] = [[] for _ in range(max((box.layer for box in boxes.values()), default=0) + 1)]
    for box in boxes.values():
        layers[box.layer].append(box.name)
    links: list[tuple[_Slot, _Slot]] = []
    for wire in forward:
        before: _Slot = wire.source
        for layer in range(boxes[wire.source].layer + 1, boxes[wire.target].layer):
            slot = (wire.source, wire.port, layer)
            if slot not in layers[layer]:
                layers[layer].append(slot)
            if (before, slot) not in links:
                links.append((before, slot))
            before = slot
        links.append((before, wire.target))
    return layers, links


def _order(layers: list[list[_Slot]], links: Sequence[tuple[_Slot, _Slot]]) -> None:
    """Order every layer by the mean place of its neighbours, sweeping to the right and back."""
    for sweep in range(_SWEEPS):
        for layer in layers if sweep % 2 == 0 else reversed(layers):
            place = {slot: i / max(len(row) - 1, 1) for row in layers for i, slot in enumerate(row)}
            ahead = sweep % 2 == 0
            means = {}
            for slot in layer:
                near = [place[a] if ahead else place[b] for a, b in links if (b if ahead else a) == slot]
                means[slot] = sum(near) / len(near) if near else place[slot]
            layer.sort(key=means.__getitem__)


def _heights(
    boxes: dict[str, Box], layers: Sequence[Sequence[_Slot]], links: Sequence[tuple[_Slot, _Slot]]
) -> dict[_Slot, float]:
    """Return the height of every slot's centre: near its neighbours, never overlapping."""
    size = {slot: boxes[slot].height if isinstance(slot, str) else LANE / 2 for row in layers for slot in row}
    centres: dict[_Slot, float] = {}
    for row in layers:
        _stack(row, [0.0] * len(row), size, centres)
    for _ in range(_SWEEPS):
        for row in layers:
            wanted = []
            for slot in row:
                near = [centres[b if a == slot else a] for a, b in links if slot in (a, b)]
                wanted.append(sum(near) / len(near) if near else centres[slot])
            _stack(row, wanted, size, centres)
    return centres


def _stack(
    row: Sequence[_Slot], wanted: Sequence[float], size: dict[_Slot, float], centres: dict[_Slot, float]
) -> None:
    """Put a layer's slots as near as may be to their wanted heights, and balance the whole."""
    floor = float("inf")
    for slot, height in zip(row, wanted, strict=True):
        centres[slot] = min(height, floor - size[slot] / 2)
        floor = centres[slot] - size[slot] / 2 - GAP_Y
    shift = sum(height - centres[slot] for slot, height in zip(row, wanted, strict=True)) / max(len(row), 1)
    for slot in row:
        centres[slot] += shift
