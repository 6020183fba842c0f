"""Places of nodes and wires in the picture of a graph: from left to right as messages go.

In layers, after Sugiyama: a wire over several columns has a place of its own in each of those between, so
that it goes around nodes; a wire that leads back goes below all of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import msgspec

WIDTH, HEIGHT = 150, 58
COLUMN, ROW, LANE, MARGIN = 290, 96, 44, 14
SWEEPS = 6
BACK, BACK_STEP = 24, 15
"""Pixels below the nodes of the first wire that leads back, and of each more."""

Ends = tuple[str, str]
Spot = tuple[str, str, int]
"""A node (its name, "", 0), or the place of a wire in a column: publisher, reader, column."""


class Corner(msgspec.Struct, frozen=True):
    x: float
    y: float


class WirePath(msgspec.Struct, frozen=True):
    """A wire's path, as SVG has it, and where its words stand."""

    path: str
    x: float
    y: float


class Layout(msgspec.Struct, frozen=True):
    places: dict[str, Corner]
    routes: dict[Ends, WirePath]
    width: float
    height: float


def layout(nodes: Iterable[str], wires: Iterable[Ends]) -> Layout:
    """Return the places of nodes and wires."""
    names = list(nodes)
    rank = {name: place for place, name in enumerate(names)}
    known = sorted(
        {(a, b) for a, b in wires if a in rank and b in rank}, key=lambda w: (rank[w[0]], rank[w[1]])
    )
    forward = _without_circles(names, [wire for wire in known if wire[0] != wire[1]])
    column = _columns(names, forward)
    spots, links = _spots(names, forward, column)
    middle = _middles(spots, links)
    top = min(middle.values(), default=0.0) - ROW / 2
    places = {
        name: Corner(MARGIN + COLUMN * column[name], MARGIN + middle[name, "", 0] - top - HEIGHT / 2)
        for name in names
    }
    bottom = max((place.y + HEIGHT for place in places.values()), default=0.0)
    lanes = {spot: y - top + MARGIN for spot, y in middle.items() if spot[1]}
    bottom = max([bottom, *lanes.values()])
    routes = {ends: _ahead(ends, places, column, lanes) for ends in forward}
    back = [ends for ends in known if ends not in routes]
    for place, ends in enumerate(back):
        routes[ends] = _back(places[ends[0]], places[ends[1]], bottom + BACK + BACK_STEP * place)
    height = bottom + MARGIN + (BACK + BACK_STEP * len(back) if back else 0)
    return Layout(places, routes, 2 * MARGIN + COLUMN * max(column.values(), default=0) + WIDTH, height)


def _columns(names: list[str], forward: list[Ends]) -> dict[str, int]:
    """Return each node's column: the longest way to it."""
    column = dict.fromkeys(names, 0)
    for _ in names:
        changed = False
        for source, target in forward:
            if column[target] < column[source] + 1:
                column[target] = column[source] + 1
                changed = True
        if not changed:
            break
    return column


def _without_circles(names: list[str], wires: list[Ends]) -> list[Ends]:
    """Return the wires without those that lead back to where one came from."""
    targets: dict[str, list[str]] = {name: [] for name in names}
    for source, target in wires:
        targets[source].append(target)
    done: set[str] = set()
    forward = []
    for root in names:
        if root in done:
            continue
        way, todo = {root}, [(root, iter(targets[root]))]
        while todo:
            name, rest = todo[-1]
            aim = next(rest, None)
            if aim is None:
                todo.pop()
                way.discard(name)
                done.add(name)
            elif aim not in way:
                forward.append((name, aim))
                if aim not in done:
                    way.add(aim)
                    todo.append((aim, iter(targets[aim])))
    return forward


def _spots(
    names: list[str], forward: list[Ends], column: dict[str, int]
) -> tuple[dict[int, list[Spot]], list[tuple[Spot, Spot]]]:
    """Return the spots of each column, and the links from one column to the next."""
    spots: dict[int, list[Spot]] = {number: [] for number in range(max(column.values(), default=0) + 1)}
    for name in names:
        spots[column[name]].append((name, "", 0))
    links = []
    for source, target in forward:
        between: list[Spot] = [
            (source, target, number) for number in range(column[source] + 1, column[target])
        ]
        for spot in between:
            spots[spot[2]].append(spot)
        links += list(pairwise([(source, "", 0), *between, (target, "", 0)]))
    return spots, links


def _middles(spots: dict[int, list[Spot]], links: list[tuple[Spot, Spot]]) -> dict[Spot, float]:
    """Return the height of each spot's middle, 0 being the picture's: near its neighbours."""
    before: dict[Spot, list[Spot]] = {}
    after: dict[Spot, list[Spot]] = {}
    for left, right in links:
        before.setdefault(right, []).append(left)
        after.setdefault(left, []).append(right)
    middle: dict[Spot, float] = {}
    for column in spots.values():
        middle |= _stacked(column)
    for sweep in range(SWEEPS):
        neighbours = before if sweep % 2 == 0 else after
        for number in sorted(spots, reverse=sweep % 2 == 1):
            near = {}
            for spot in spots[number]:
                others = neighbours.get(spot, [spot])
                near[spot] = sum(middle[other] for other in others) / len(others)
            middle |= _stacked(sorted(spots[number], key=lambda spot: near[spot]))
    return middle


def _stacked(column: list[Spot]) -> dict[Spot, float]:
    """Return the middles of a column's spots, one below the other around 0."""
    sizes = [LANE if spot[1] else ROW for spot in column]
    at, found = -sum(sizes) / 2, {}
    for spot, size in zip(column, sizes, strict=True):
        found[spot] = at + size / 2
        at += size
    return found


def _ahead(
    ends: Ends, places: dict[str, Corner], column: dict[str, int], lanes: dict[Spot, float]
) -> WirePath:
    """Return a wire to the right, through its places in the columns between."""
    source, target = places[ends[0]], places[ends[1]]
    points = [(source.x + WIDTH, source.y + HEIGHT / 2)]
    for number in range(column[ends[0]] + 1, column[ends[1]]):
        x, y = MARGIN + COLUMN * number, lanes[*ends, number]
        points += [(x, y), (x + WIDTH, y)]
    points.append((target.x, target.y + HEIGHT / 2))
    path = f"M{points[0][0]:g} {points[0][1]:g}"
    for (x0, y0), (x1, y1) in pairwise(points):
        bend = (x1 - x0) / 2
        path += f" C{x0 + bend:g} {y0:g} {x1 - bend:g} {y1:g} {x1:g} {y1:g}"
    if len(points) > 2:  # its words stand where nothing else does: in its own lane
        return WirePath(path, points[1][0] + WIDTH / 2, points[1][1] - 4)
    return WirePath(path, (points[0][0] + points[1][0]) / 2, (points[0][1] + points[1][1]) / 2 - 4)


def _back(source: Corner, target: Corner, low: float) -> WirePath:
    """Return a wire to the left, or to the node itself, below all nodes."""
    x0, x1 = source.x + WIDTH / 2 + 12, target.x + WIDTH / 2 - 12
    y0, y1 = source.y + HEIGHT, target.y + HEIGHT
    turn = 18.0 if x0 > x1 else -18.0
    path = (
        f"M{x0:g} {y0:g} L{x0:g} {low - 18:g} Q{x0:g} {low:g} {x0 - turn:g} {low:g} "
        f"L{x1 + turn:g} {low:g} Q{x1:g} {low:g} {x1:g} {low - 18:g} L{x1:g} {y1:g}"
    )
    return WirePath(path, (x0 + x1) / 2, low - 3)
