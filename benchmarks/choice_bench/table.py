"""What came of the scenes: a line per task, every scene in a CSV, and a picture."""

from __future__ import annotations

import json
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.choice_bench.contest import Verdict
from palp_core.palpation.perception.statistics.statistics import wilson
from palp_core.palpation.reporting.charts import BLUE, GREY, VERMILION, Chart, save, tidy
from palp_core.palpation.reporting.table import write_records

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEAD = (
    "task", "scenes", "answered", "refused", "needlessly", "kept", "95 %", "unclear", "not kept",
    "bounds broken", "cost over best: median", "worst",
)  # fmt: skip


@dataclass(frozen=True)
class Line:
    """What came of a task's scenes; see :data:`HEAD`."""

    task: str
    scenes: int
    redrawn: int
    answered: int
    refused: int
    needless: int
    kept: int
    unclear: int
    not_kept: int
    kept_low: float | None
    kept_high: float | None
    bounds_stated: int
    bounds_broken: int
    ratio_median: float | None
    ratio_worst: float | None
    chosen: dict[str, int]

    @classmethod
    def of(cls, task: str, found: Sequence[Verdict], redrawn: int) -> Line:
        """Return what the verdicts of a task come to; unclear ones count as neither kept nor not."""
        answers = [one for one in found if one.chosen]
        counts = Counter(one.kept for one in answers)
        clear = counts["yes"] + counts["no"]
        share = wilson(counts["yes"], clear) if clear else None
        ratios = [one.cost_ratio for one in answers if one.kept != "no" and one.best]
        return cls(
            task=task,
            scenes=len(found),
            redrawn=redrawn,
            answered=len(answers),
            refused=len(found) - len(answers),
            needless=sum(one.needless for one in found),
            kept=counts["yes"],
            unclear=counts["unclear"],
            not_kept=counts["no"],
            kept_low=share.low if share else None,
            kept_high=share.high if share else None,
            bounds_stated=sum(one.stated for one in found),
            bounds_broken=sum(len(one.broken) for one in found),
            ratio_median=statistics.median(ratios) if ratios else None,
            ratio_worst=max(ratios, default=None),
            chosen=dict(Counter(one.chosen for one in answers)),
        )

    def cells(self) -> list[str]:
        """Return it in words."""
        span = (
            "-"
            if self.kept_low is None
            else f"{100 * self.kept_low:.1f} to {100 * (self.kept_high or 0):.0f}"
        )
        ratios = ["-" if one is None else f"{one:.3g}" for one in (self.ratio_median, self.ratio_worst)]
        counts = (self.scenes, self.answered, self.refused, self.needless, self.kept)
        broken = f"{self.bounds_broken} of {self.bounds_stated}"
        return [self.task, *map(str, counts), span, str(self.unclear), str(self.not_kept), broken, *ratios]


def markdown(lines: Sequence[Line]) -> str:
    """Return the table as docs have it."""
    rows = [list(HEAD), ["---"] * len(HEAD), *(one.cells() for one in lines)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def write(out: Path, lines: Sequence[Line], found: Sequence[Verdict], about: dict[str, Any]) -> None:
    """Write ``choices.json``, ``scenes.csv`` and ``choices.png`` with its numbers into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps({**about, "tasks": [vars(one) for one in lines]}, indent=1)
    (out / "choices.json").write_text(text + "\n", encoding="utf-8")
    if found:
        write_records(out / "scenes.csv", [one.row() for one in found])
        save(_chart(found), out)


def _chart(found: Sequence[Verdict]) -> Chart:
    answers = [one for one in found if one.chosen and one.tolerance > 0.0]
    tasks = sorted({one.task for one in answers})
    rows = [(one.task, one.tolerance, one.bound, one.error, one.sd, one.kept) for one in answers]

    def draw(to: Figure) -> None:
        axes = to.subplots()
        for row, task in enumerate(tasks):
            mine = [one for one in answers if one.task == task]
            for i, one in enumerate(mine):
                colour = {"yes": BLUE, "no": VERMILION}.get(one.kept, GREY)
                height = row + 0.7 * (i / max(len(mine) - 1, 1) - 0.5)
                axes.plot(max(one.error / one.tolerance, 1e-4), height, "o", ms=2.5, color=colour)
        axes.axvline(1.0, color=GREY, lw=0.9)
        axes.set_xscale("log")
        axes.set_yticks(range(len(tasks)), tasks)
        across = "true error of the choice over the tolerance (below 1e-4: drawn there)"
        tidy(axes, "What the register chose, a point per scene", across, "")

    return Chart(
        "choices",
        "Choices of the register",
        "A point per scene that was answered. Right of the line the tolerance was not kept; grey: unclear.",
        0.5 + 0.45 * max(len(tasks), 3),
        ("task", "tolerance", "bound", "error", "sd", "kept"),
        rows,
        draw,
    )
