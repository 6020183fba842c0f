"""Words beside points that do not lie on each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PLACES = (
    (7, -2.5, "left"), (-7, -2.5, "right"), (0, 8, "center"), (0, -14, "center"), (7, 7, "left"),
    (7, -12, "left"), (-7, 7, "right"), (-7, -12, "right"), (0, 18, "center"), (0, -24, "center"),
    (14, 16, "left"), (14, -21, "left"),
)  # fmt: skip
_FROM_RING = 1.7  # a label of a point with a ring is so much further away
_WIDTH, _HEIGHT = 0.56, 1.25  # of a letter, in its size


class Labels:
    """Labels of one panel, each put where it covers least of what is there already.

    Args:
        axes: The panel, its limits set.
    """

    def __init__(self, axes: Axes) -> None:
        self._axes = axes
        self._taken: list[tuple[float, float, float, float]] = []

    def keep_free(self, x: float, y: float, radius: float = 4.0) -> None:
        """Cover a point as little as can be; its radius in points."""
        at_x, at_y = self._points(x, y)
        self._taken.append((at_x - radius, at_y - radius, at_x + radius, at_y + radius))

    def write(self, text: str, x: float, y: float, *, bold: bool = False, small: bool = False) -> None:
        """Write words beside a point; bold ones beside one with a ring."""
        from matplotlib.patheffects import withStroke

        size = 6.2 if small else 7.5
        at_x, at_y = self._points(x, y)
        away = _FROM_RING if bold else 1.0
        places = [(dx * away, dy * away, align) for dx, dy, align in _PLACES]
        boxes = []
        for dx, dy, align in places:
            wide, tall = _WIDTH * size * len(text), _HEIGHT * size
            left = at_x + dx - {"left": 0.0, "center": 0.5, "right": 1.0}[align] * wide
            boxes.append((left, at_y + dy, left + wide, at_y + dy + tall))
        best = min(range(len(boxes)), key=lambda i: (self._covered(boxes[i]), i))
        dx, dy, align = places[best]
        self._taken.append(boxes[best])
        self._axes.annotate(
            text, (x, y), xytext=(dx, dy), textcoords="offset points", fontsize=size, ha=align, va="bottom",
            fontweight="bold" if bold else "normal", zorder=6, annotation_clip=False, parse_math=False,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip

    def _points(self, x: float, y: float) -> tuple[float, float]:
        pixels: Any = self._axes.transData.transform((x, y))
        scale = 72.0 / self._axes.figure.get_dpi()
        return float(pixels[0] * scale), float(pixels[1] * scale)

    def _covered(self, box: tuple[float, float, float, float]) -> float:
        """Return the area that a label would share with others, and with what is outside the panel."""
        left, low, right, top = box
        total = 0.0
        for a, b, c, d in self._taken:
            total += max(0.0, min(right, c) - max(left, a)) * max(0.0, min(top, d) - max(low, b))
        (x0, x1), (y0, y1) = self._axes.get_xlim(), self._axes.get_ylim()
        (a, b), (c, d) = self._points(x0, y0), self._points(x1, y1)
        inside = max(0.0, min(right, c) - max(left, a)) * max(0.0, min(top, d) - max(low, b))
        return total + 2.0 * ((right - left) * (top - low) - inside)
