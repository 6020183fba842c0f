"""The study ``contact-validity``: is the chosen model right enough on random scenes, and at what cost?

Every scene is a line of ``scenes.jsonl``, written when it is done: a run that was stopped goes on where it
was, and lines of other models or another draw are judged again.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.reporting.charts import BLUE, GREEN, GREY, SKY, Chart, legend, tidy
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.contact.judged import NEAR, Judged, judge
from palp_core.palpation.studies.toolkit.checkpoint import read_lines
from palp_core.whole_file import append_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SCENES, _QUICK = (200, 50), (10, 2)  # anywhere, and near the published rig
LINES = "scenes.jsonl"


def kept(out: Path, *, any_code: bool = False) -> dict[int, Judged]:
    """Return the judged scenes of a folder by index, those of other models or another draw left out.

    Args:
        out: Folder of the study.
        any_code: Take them whatever the source of the models was.
    """
    read = (Judged.of_line(line, any_code=any_code) for line in read_lines(out / LINES))
    return {one.index: one for one in read if one is not None}


def scenes(
    out: Path, count: int, first: int = 0, *, timed: bool = True, tell: Callable[[str], object] | None = None
) -> Iterator[Judged]:
    """Judge random scenes until so many have an answer, keeping each as it comes, and give every one.

    Args:
        out: Folder for ``scenes.jsonl``; made if missing.
        count: How many with an answer; those skipped come on top.
        first: Index of the first.
        timed: Also time the rungs.
        tell: Told of each scene that had to be judged; the error stream by default.
    """
    out.mkdir(parents=True, exist_ok=True)
    done, answered = kept(out), 0
    for index in itertools.count(first):
        if answered == count:
            return
        one = done.get(index)
        if one is None:
            one = judge(index, timed=timed)
            append_whole(out / LINES, f"{one.line()}\n")
            (tell or sys.stderr.write)(f"{answered + 1}/{count} scene {index}: {_said(one)}\n")
        answered += not one.skipped
        yield one


def _said(one: Judged) -> str:
    asked = one.scene.tolerance
    if one.skipped:
        return one.skipped
    chosen = f"{one.rung} off by {one.own.get(one.rung, np.inf):.2%}" if one.rung else "refused"
    words = f"{asked.output} within {asked.relative:.1%}: {chosen}"
    return "; ".join([words, *one.broken])


def run(out: Path, *, quick: bool = False) -> Path:
    """Judge random scenes, write the chart and the page, and return the page.

    Args:
        out: Folder for the files; made if missing. Scenes that it holds already are not judged again.
        quick: 10 scenes anywhere and 2 near the published rig rather than 200 and 50.
    """
    anywhere, near = _QUICK if quick else _SCENES
    drawn = [*scenes(out, anywhere), *scenes(out, near, NEAR)]
    judged = [one for one in drawn if not one.skipped]
    failed = [one for one in drawn if one.failed]
    chosen = [one for one in judged if one.rung]
    ratios = [one.cost_ratio for one in chosen if one.cost_ratio is not None]
    counts = {name: sum(one.rung == name for one in chosen) for name in sorted({one.rung for one in chosen})}
    setups = [one.setup_s["l4"] / len(one.scene.phantoms) for one in judged if "l4" in one.setup_s]
    return write_page(
        out / "index.html",
        "studies/contact_validity.html",
        judged_count=len(judged),
        near_count=near,
        chosen_count=len(chosen),
        counts=counts,
        redrawn_count=len(drawn) - len(judged) - len(failed),
        failed=[one.skipped for one in failed],
        wrong_count=sum(one.wrong for one in chosen),
        broken=[words for one in judged for words in one.broken],
        cost_ratios=ratios or [1.0],
        median_cost_ratio=np.median(ratios or [1.0]),
        setups_s=setups or [0.0],
        median_setup_s=np.median(setups or [0.0]),
        picture=picture(_chart(judged), out),
        worst=_closest(judged),
    )


def _closest(judged: Sequence[Judged]) -> list[tuple[str, str, float, float, int]]:
    """Return rung, output and stated bound with the largest error seen, and in how many scenes."""
    worst: dict[tuple[str, str, float], tuple[float, int]] = {}
    for one in judged:
        for output, stated in one.bounds.items():
            for rung, bound in stated.items():
                error, count = worst.get((rung, output, bound), (0.0, 0))
                here = one.errors[output].get(rung, np.inf)
                worst[rung, output, bound] = (max(error, here), count + 1)
    return [(*key, *found) for key, found in sorted(worst.items())]


def _chart(judged: Sequence[Judged]) -> Chart:
    points = [
        (rung, output, bound, one.errors[output][rung], int(rung == one.rung))
        for one in judged
        for output, stated in one.bounds.items()
        for rung, bound in stated.items()
        if rung in one.errors[output]
    ]

    def draw(to: Figure) -> None:
        axes = to.subplots()
        for rung, marker, colour in (("l2", "o", GREEN), ("l4", "s", BLUE), ("l0", "v", SKY)):
            x = [p[2] for p in points if p[0] == rung]
            y = [max(p[3], 1e-6) for p in points if p[0] == rung]
            axes.scatter(x, y, s=16, marker=marker, color=colour, alpha=0.7, label=rung.upper())
        ends = [1e-3, 1.0]
        axes.plot(ends, ends, color=GREY, lw=0.9)
        axes.set_xscale("log")
        axes.set_yscale("log")
        legend(axes, "rung")
        tidy(axes, "stated and true error", "stated bound", "true error, against L4 at 0.5 mm")

    return Chart(
        "validity",
        "Stated bounds against true errors",
        "A point per scene, output and rung that states a bound for it. Above the line a bound is not kept.",
        4.4,
        ("rung", "output", "bound", "error", "chosen"),
        points,
        draw,
    )
