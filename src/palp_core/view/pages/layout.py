"""Where nodes and wires stand in the picture of a graph: from left to right as messages go."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

WIDTH, HEIGHT = 150, 58
COLUMN, ROW, MARGIN = 320, 92, 14


class Corner(msgspec.Struct, frozen=True):
    """A node's upper left corner."""

    x: float
    y: float


class Layout(msgspec.Struct, frozen=True):
    """Where everything stands."""

    places: dict[str, Corner]
    width: float
    height: float


def layout(nodes: Iterable[str], wires: Iterable[tuple[str, str]]) -> Layout:
    """Return where nodes stand: each right of those it reads, as far as there is no circle.

    Args:
        nodes: In graph order.
        wires: From publisher to reader.
    """
    names = list(nodes)
    known = {(a, b) for a, b in wires if a in names and b in names and a != b}
    column = _columns(names, sorted(known, key=lambda wire: (names.index(wire[0]), names.index(wire[1]))))
    rows: dict[int, list[str]] = {}
    for name in names:
        rows.setdefault(column[name], []).append(name)
    place: dict[str, float] = {}
    for number in sorted(rows):
        place |= _ordered(rows[number], known, place)
    most = max((len(column_names) for column_names in rows.values()), default=1)
    places = {
        name: Corner(
            MARGIN + COLUMN * column[name],
            MARGIN + ROW * (place[name] + (most - len(rows[column[name]])) / 2),
        )
        for name in names
    }
    return Layout(places, 2 * MARGIN + COLUMN * max(rows, default=0) + WIDTH, 2 * MARGIN + ROW * most)


def _columns(names: list[str], wires: list[tuple[str, str]]) -> dict[str, int]:
    """Return each node's column: the longest way to it over wires that do not lead back."""
    forward = _without_circles(names, wires)
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


def _without_circles(names: list[str], wires: list[tuple[str, str]]) -> list[tuple[str, str]]:
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


def _ordered(names: list[str], wires: set[tuple[str, str]], before: dict[str, float]) -> dict[str, float]:
    """Return the rows of a column: near those that its nodes read."""

    def wish(name: str) -> tuple[float, int]:
        read = [before[source] for source, target in wires if target == name and source in before]
        return (sum(read) / len(read) if read else names.index(name)), names.index(name)

    return {name: float(row) for row, name in enumerate(sorted(names, key=wish))}


def path(source: Corner, target: Corner) -> tuple[str, float, float]:
    """Return a wire's path, as SVG has it, and where its words stand."""
    if target.x > source.x:
        x0, y0, x1, y1 = source.x + WIDTH, source.y + HEIGHT / 2, target.x, target.y + HEIGHT / 2
        bend = (x1 - x0) / 2
        return (
            f"M{x0:g} {y0:g} C{x0 + bend:g} {y0:g} {x1 - bend:g} {y1:g} {x1:g} {y1:g}",
            (x0 + x1) / 2,
            (y0 + y1) / 2 - 4,
        )
    x0, x1 = source.x + WIDTH / 2, target.x + WIDTH / 2 + (20 if source.x == target.x else 0)
    y0, y1 = source.y + HEIGHT, target.y + HEIGHT
    low = max(y0, y1) + 26
    return f"M{x0:g} {y0:g} C{x0:g} {low:g} {x1:g} {low:g} {x1:g} {y1:g}", (x0 + x1) / 2, low - 6
