"""A labelled drawing of probe, ring and phantom, to scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from palp_core.palpation.reporting.charts import BLUE, GREEN, GREY, INK, PALE_BLUE, VERMILION, Chart, tidy
from palp_core.palpation.session.result import Based

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PROBE_AT_MM, _SLAB_MM = -28.0, 60.0


def rig_chart(
    scene: Mapping[str, Mapping[str, Based]], *, rings_m: Sequence[float], indentation_m: float
) -> Chart:
    """Return the drawing."""
    mm = {
        thing: {name: 1e3 * one.value for name, one in numbers.items() if name.endswith("_m")}
        for thing, numbers in scene.items()
    }
    probe = mm["probe"]
    phantoms = {code: numbers for code, numbers in mm.items() if code != "probe"}
    pressed, rings = 1e3 * indentation_m, sorted(1e3 * ring_m for ring_m in rings_m)
    rows = [
        (thing, name, round(value, 6)) for thing, numbers in mm.items() for name, value in numbers.items()
    ]
    rows += [("ring", "ring_m", round(ring, 6)) for ring in rings]
    rows.append(("stage", "indentation_m", pressed))

    def draw(figure: Figure) -> None:
        whole, near = figure.subplots(1, 2, width_ratios=(1, 1.25))
        _slab(whole, phantoms)
        _probe(whole, probe, rings, pressed)
        whole.set_xlim(-_SLAB_MM, 1.4 * _SLAB_MM)
        _beads(near, phantoms, probe["tip_radius_m"], pressed)
        for axes in (whole, near):
            axes.set_aspect("equal")
            axes.grid(visible=False)
        tidy(whole, "The rig", "along the sweep, mm", "over the surface, mm")
        tidy(near, "Ball and phantoms, nearer", "mm", "")

    return Chart(
        "rig",
        "The rig, to scale",
        "Side view. The stage drags the probe over the phantom, from left to right; the ball is drawn at its "
        f"nominal depth, {pressed:g} mm, before gel and joint give way. The ring's height r_a over the joint "
        "sets the joint's stiffness; the torque is measured at the upper end of the base link. Right: one "
        "phantom beside the other, each with its bead.",
        4.6,
        ("of", "quantity", "mm"),
        rows,
        draw,
    )


def _slab(axes: Axes, phantoms: Mapping[str, Mapping[str, float]]) -> None:
    from matplotlib.patches import Circle, Rectangle

    height = max(one["height_m"] for one in phantoms.values())
    axes.add_patch(Rectangle((-_SLAB_MM, -height), 2 * _SLAB_MM, height, facecolor=PALE_BLUE, edgecolor=BLUE))
    buried = [one for one in phantoms.values() if "depth_m" in one]
    deepest = max(buried, key=lambda one: one["depth_m"], default=None)
    _words(
        axes, f"phantom, {height:g} mm of gel", (0.75 * _SLAB_MM, -height), (0.72 * _SLAB_MM, -height - 14)
    )
    if deepest is not None:
        radius = deepest["radius_m"]
        axes.add_patch(Circle((0.0, -deepest["depth_m"] - radius), radius, facecolor=GREY, edgecolor=INK))
        _words(axes, f"bead, {2 * radius:g} mm", (radius, -deepest["depth_m"] - radius), (22, 12))
    axes.set_ylim(-height - 24, None)


def _probe(axes: Axes, probe: Mapping[str, float], rings: Sequence[float], pressed: float) -> None:
    from matplotlib.patches import Circle, Rectangle

    x, radius, pivot = _PROBE_AT_MM, probe["tip_radius_m"], probe["pivot_radius_m"]
    joint = probe["tip_m"] - pressed
    top, beside = joint + probe["base_m"], x + 22.0
    axes.plot([x, x], [joint, top], color=INK, lw=5, solid_capstyle="butt")
    axes.plot([x, x], [radius - pressed, joint], color=GREY, lw=3)
    axes.add_patch(Circle((x, radius - pressed), radius, facecolor=VERMILION, edgecolor=INK))
    axes.add_patch(Circle((x, joint), pivot, facecolor="white", edgecolor=INK, lw=1.4, zorder=3))
    for ring in rings:
        axes.plot([x - 9, x - 6], [joint + ring] * 2, color=GREEN, lw=1.0)
    highest = joint + rings[-1]
    for side in (-pivot, pivot):
        axes.plot([x + side] * 2, [joint, highest], color=GREEN, lw=1.0, zorder=4)
    axes.add_patch(Rectangle((x - 9, highest - 1.5), 18, 3, facecolor=GREEN, edgecolor=INK, zorder=5))
    axes.add_patch(Rectangle((x - 11, top), 22, 10, facecolor=BLUE, edgecolor=INK))
    words = ", ".join(f"{ring:g}" for ring in rings)
    _words(axes, "torque sensor", (x + 11, top + 5), (beside, top + 5))
    _words(
        axes,
        f"base link, {probe['base_m']:g} mm",
        (x + 2, joint + 0.65 * probe["base_m"]),
        (beside, joint + 0.65 * probe["base_m"]),
    )
    _words(axes, f"ring at r_a =\n{words} mm", (x + 9, highest), (beside, highest + 8))
    _words(axes, f"joint, R = {pivot:g} mm", (x + pivot, joint), (beside, joint - 10))
    _words(axes, f"tip link, {probe['tip_m']:g} mm", (x + 1, 0.5 * joint), (beside, 0.5 * joint))
    axes.annotate("", (x + 30, top + 22), (x, top + 22), arrowprops={"arrowstyle": "->", "color": INK})
    axes.text(x, top + 25, "sweep of the stage", fontsize=8)
    axes.set_ylim(top=top + 36)


def _beads(
    axes: Axes, phantoms: Mapping[str, Mapping[str, float]], tip_radius: float, pressed: float
) -> None:
    from matplotlib.patches import Circle, Rectangle

    height = max(one["height_m"] for one in phantoms.values())
    wide = 3.4 * max([one.get("radius_m", 0.0) for one in phantoms.values()] + [tip_radius])
    for place, (code, one) in enumerate(phantoms.items()):
        middle = wide * (place + 0.5)
        axes.add_patch(
            Rectangle(
                (middle - wide / 2, -one["height_m"]),
                wide,
                one["height_m"],
                facecolor=PALE_BLUE,
                edgecolor=BLUE,
            )
        )
        words = f"{code}: bare"
        if "depth_m" in one:
            words = f"{code}: d = {one['depth_m']:g}"
            centre = -one["depth_m"] - one["radius_m"]
            axes.add_patch(Circle((middle, centre), one["radius_m"], facecolor=GREY, edgecolor=INK))
            axes.annotate(
                "",
                (middle, -one["depth_m"]),
                (middle, 0.0),
                arrowprops={"arrowstyle": "<->", "color": VERMILION, "shrinkA": 0, "shrinkB": 0},
            )
        axes.text(middle, -one["height_m"] - 3, words, ha="center", va="top", fontsize=8)
    first = -tip_radius - 4.0
    axes.add_patch(Circle((first, tip_radius - pressed), tip_radius, facecolor=VERMILION, edgecolor=INK))
    axes.plot([first - tip_radius - 2, 0.0], [0.0, 0.0], color=BLUE, lw=0.8, ls=":")
    axes.text(first, 2 * tip_radius - pressed + 2, f"ball,\nradius {tip_radius:g}", ha="center", fontsize=8)
    axes.text(first, -pressed - 2, f"{pressed:g} mm\ndeep", ha="center", va="top", fontsize=8)
    axes.set_xlim(first - tip_radius - 5, wide * len(phantoms) + 2)
    axes.set_ylim(-height - 9, 2 * tip_radius + 12)


def _words(axes: Axes, words: str, at: tuple[float, float], beside: tuple[float, float]) -> None:
    """Write words beside a thing, with a line that leads to it."""
    axes.annotate(
        words, at, beside, va="center", fontsize=8, arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.8}
    )
